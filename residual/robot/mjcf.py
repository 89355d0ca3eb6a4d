"""MJCF as a URDF, by MuJoCo's own compiler, and what else of it a dynamic model needs.

Pinocchio reads MJCF too, but not its gravity, the equalities between joints and the
springs, and it scales the range of a slide. What MuJoCo has compiled is bodies in a
tree, each with its joints; a body of several joints becomes links without mass.
"""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from residual.errors import RobotError, not_installed, shortened
from residual.recording import Array

_KINDS = {2: "prismatic", 3: "revolute"}  # mjtJoint; 0 is free, 1 a ball
_JOINT_EQUALITY = 2  # mjtEq


class CompiledFile(NamedTuple):
    """What MuJoCo makes of an MJCF."""

    urdf: str
    gravity: tuple[float, ...] | None = None  # [m/s^2]
    # Properties of the joints, those of `residual.effects.base.Property`, by joint.
    properties: Mapping[str, Mapping[str, float]] = MappingProxyType({})
    notes: tuple[str, ...] = ()


def read_mjcf(path: Path) -> CompiledFile:
    """Compile an MJCF file and write it as a URDF.

    Raises:
        RobotError: If MuJoCo refuses it.
        InputError: If MuJoCo is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise not_installed("mujoco") from error
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, RuntimeError) as error:
        why = shortened(" ".join(str(error).split()))
        raise RobotError(f"MuJoCo does not compile {path.name}: {why}") from error
    return _Writer(model).compiled()


class _Writer:
    def __init__(self, model) -> None:
        self.m = model
        name = model.names.split(b"\0")[0].decode() or "arm"
        self.root = ET.Element("robot", {"name": name})
        self.notes: list[str] = []
        names = ("damping", "friction", "armature")
        self.properties: dict[str, dict[str, float]] = {name: {} for name in names}
        # Of each body: its link, and where the body's frame is in that of the link.
        self.frames: list[tuple[str, pin.SE3]] = []

    def compiled(self) -> CompiledFile:
        ET.SubElement(self.root, "link", {"name": "world"})
        self.frames.append(("world", pin.SE3.Identity()))
        for b in range(1, self.m.nbody):
            self._body(b)
        self._equalities()
        text = ET.tostring(self.root, encoding="unicode")
        gravity = tuple(float(g) for g in self.m.opt.gravity)
        return CompiledFile(text, gravity, self.properties, tuple(self.notes))

    def _body(self, b: int) -> None:
        m = self.m
        parent, at = self.frames[m.body_parentid[b]]
        place = at * _placed(m.body_pos[b], m.body_quat[b])
        name = m.body(b).name or f"body{b}"
        first, count = m.body_jntadr[b], m.body_jntnum[b]
        joints = [j for j in range(first, first + count) if m.jnt_type[j] in _KINDS]
        if len(joints) < count:
            kind = "ball" if (m.jnt_type[first : first + count] == 1).any() else "free"
            self.notes.append(f"body '{name}' is held where it is: its joint is {kind}")
        inside = pin.SE3.Identity()
        for j in joints:
            last = j == joints[-1]
            joint = m.jnt(j).name or f"joint{j}"
            link = name if last else f"{name}/{joint}"
            anchor = pin.SE3(np.eye(3), np.array(m.jnt_pos[j]))
            origin = place * inside * anchor * self._reference(j)
            self._joint(j, joint, parent, link, origin)
            parent, place, inside = link, pin.SE3.Identity(), anchor.inverse()
            if not last:
                ET.SubElement(self.root, "link", {"name": link})
        if not joints:
            fixed = {"name": f"{name}_fixed", "type": "fixed"}
            node = ET.SubElement(self.root, "joint", fixed)
            _ends(node, parent, name, place)
        self._link(b, name, inside)
        self.frames.append((name, inside))

    def _reference(self, j: int) -> pin.SE3:
        """The pose of an MJCF is that at the joint's reference, of a URDF at zero."""
        away = -float(self.m.qpos0[self.m.jnt_qposadr[j]]) * self.m.jnt_axis[j]
        if _KINDS[self.m.jnt_type[j]] == "prismatic":
            return pin.SE3(np.eye(3), np.array(away))
        return pin.SE3(pin.exp3(np.array(away)), np.zeros(3))

    def _joint(
        self, j: int, name: str, parent: str, link: str, origin: pin.SE3
    ) -> None:
        m, kind = self.m, _KINDS[self.m.jnt_type[j]]
        if kind == "revolute" and not m.jnt_limited[j]:
            kind = "continuous"
        node = ET.SubElement(self.root, "joint", {"name": name, "type": kind})
        _ends(node, parent, link, origin)
        ET.SubElement(node, "axis", {"xyz": _text(m.jnt_axis[j])})
        low, high = m.jnt_range[j] if m.jnt_limited[j] else (0.0, 0.0)
        limit = {"lower": repr(float(low)), "upper": repr(float(high))}
        limit |= {"effort": repr(self._effort(j)), "velocity": "0"}
        ET.SubElement(node, "limit", limit)
        dof = m.jnt_dofadr[j]
        self.properties["damping"][name] = float(m.dof_damping[dof])
        self.properties["friction"][name] = float(m.dof_frictionloss[dof])
        self.properties["armature"][name] = float(m.dof_armature[dof])
        if m.jnt_stiffness[j] or m.dof_dampingpoly[dof].any():
            self.notes.append(
                f"joint '{name}': its spring and damping by powers are not taken over"
            )

    def _effort(self, j: int) -> float:
        m = self.m
        if m.jnt_actfrclimited[j]:
            return float(np.abs(m.jnt_actfrcrange[j]).max())
        most = 0.0
        for a in range(m.nu):
            drives = m.actuator_trntype[a] in (0, 1) and m.actuator_trnid[a, 0] == j
            if drives and m.actuator_forcelimited[a]:
                force = np.abs(m.actuator_forcerange[a]).max()
                most = max(most, float(force * abs(m.actuator_gear[a, 0])))
        return most

    def _link(self, b: int, name: str, inside: pin.SE3) -> None:
        link = ET.SubElement(self.root, "link", {"name": name})
        mass = float(self.m.body_mass[b])
        if mass > 0:
            place = inside * _placed(self.m.body_ipos[b], self.m.body_iquat[b])
            node = ET.SubElement(link, "inertial")
            ET.SubElement(node, "origin", _origin(place))
            ET.SubElement(node, "mass", {"value": repr(mass)})
            moments = zip(("ixx", "iyy", "izz"), self.m.body_inertia[b], strict=True)
            tensor = {key: repr(float(value)) for key, value in moments}
            tensor |= {"ixy": "0", "ixz": "0", "iyz": "0"}
            ET.SubElement(node, "inertia", tensor)

    def _equalities(self) -> None:
        m = self.m
        nodes = {n.get("name"): n for n in self.root.iter("joint")}
        loops = 0
        for e in np.flatnonzero(m.eq_active0):
            if m.eq_type[e] != _JOINT_EQUALITY:
                loops += 1
                continue
            first, second = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
            reference = m.qpos0[m.jnt_qposadr[first]]
            offset, factor = float(reference + m.eq_data[e, 0]), float(m.eq_data[e, 1])
            leader = m.jnt(second).name or f"joint{second}" if second >= 0 else ""
            if second >= 0:
                offset -= float(factor * m.qpos0[m.jnt_qposadr[second]])
            name = m.jnt(first).name or f"joint{first}"
            if m.eq_data[e, 2:5].any():
                self.notes.append(f"joint '{name}' follows '{leader}' by a line only")
            follower = nodes[name]
            mimic = {"joint": leader, "multiplier": repr(factor)}
            ET.SubElement(follower, "mimic", mimic | {"offset": repr(offset)})
        if loops:
            self.notes.append(f"{loops} constraint(s) between bodies are not modelled")


def _placed(position: Array, quaternion: Array) -> pin.SE3:
    w, x, y, z = (float(v) for v in quaternion)
    turned = pin.Quaternion(w, x, y, z).normalized().toRotationMatrix()
    return pin.SE3(turned, np.array(position, dtype=float))


def _ends(node: ET.Element, parent: str, child: str, place: pin.SE3) -> None:
    ET.SubElement(node, "parent", {"link": parent})
    ET.SubElement(node, "child", {"link": child})
    ET.SubElement(node, "origin", _origin(place))


def _origin(place: pin.SE3) -> dict[str, str]:
    turned = pin.rpy.matrixToRpy(place.rotation)
    return {"xyz": _text(place.translation), "rpy": _text(turned)}


def _text(values: Array) -> str:
    return " ".join(repr(float(v)) for v in values)
