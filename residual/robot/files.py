"""Readers of URDF (Pinocchio), MJCF (MuJoCo), xacro and robot.toml.

Pinocchio reads MJCF too, but not its gravity, the equalities between joints and the
springs, and it scales the range of a slide. MuJoCo compiles it to a tree of bodies, each
with its joints; a body with several joints becomes several links, some without mass.
"""

import os
import re
import sys
import tempfile
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from residual.errors import (
    InputError,
    RobotError,
    build_missing_package_error,
    check_keys,
    check_name,
    check_nesting,
    quote_value,
    shorten_value,
)
from residual.recording import Array
from residual.robot.urdf import GRAVCOMP, ArmChoice, abbreviate_list, format_numbers, write_origin


def expand_xacro(path: Path, args: Sequence[str], packages: Sequence[str]) -> str:
    """Expand a xacro.

    Args:
        args: Its arguments, as "name:=value".
        packages: Folders of packages, or packages, searched by $(find name) before the
            folders above the file.

    Raises:
        RobotError: If it does not expand.
        InputError: If an argument is none, or xacrodoc is not installed.
    """
    try:
        import xacro
        from xacrodoc import XacroDoc
        from xacrodoc import packages as finder
    except ImportError as error:
        raise build_missing_package_error("xacrodoc") from error
    arguments = {}
    for word in args:
        name, sign, value = word.partition(":=")
        if not sign or not name:
            raise InputError(
                f"--xacro-arg '{shorten_value(word)}': expected name:=value, such as ur_type:=ur5e."
            )
        arguments[name] = value
    finder.reset()
    # A folder counts as a package by its name, with or without a package.xml.
    above = list(path.resolve().parents)
    places = [*reversed(above), *(Path(p).resolve() for p in packages)]
    beside = [p for folder in (*packages, *above[:3]) for p in Path(folder).iterdir()]
    folders = {p.name: p for p in (*reversed(beside), *places) if p.is_dir()}
    finder.update_package_cache(folders)
    # A relative include starts at the including file, not at the previously read one.
    xacro.init_stacks(str(path.resolve()))
    try:
        # Meshes are not needed, nor are their folders.
        document = XacroDoc.from_file(path, subargs=arguments, resolve_packages=False)
        return document.dom.toxml()
    except Exception as error:
        # A macro may make the parser raise any error.
        why = shorten_value(" ".join(str(error).split()) or type(error).__name__)
        raise RobotError(
            f"{path.name} does not expand: {why} Arguments are given by --xacro-arg "
            "name:=value, folders of packages by --package-dir."
        ) from error


def build_pinocchio_model(text: str, where: str) -> pin.Model:
    """Build the Pinocchio model of a URDF text.

    Raises:
        RobotError: If the parser refuses it, with what the parser printed, or drops
            the inertia of a link.
    """
    noise: list[str] = []
    model = None
    try:
        with _captured_stderr(noise):
            model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        noise.append(f"Error: {error}")
    # The parser uses a point mass where it cannot read an inertia.
    if model is None or "nertia" in noise[0]:
        reasons = re.findall(r"Error:\s+(.*)", "\n".join(noise))
        raise RobotError(f"{where} is not a usable URDF: {'; '.join(reasons[:2])[:180]}")
    places = zip(model.names, model.inertias, model.jointPlacements, strict=True)
    numbers = {f"joint '{n}'": (i.toDynamicParameters(), p.translation) for n, i, p in places}
    numbers |= {f"frame '{f.name}'": (f.placement.translation,) for f in model.frames}
    for name, values in numbers.items():
        if not (np.abs(np.concatenate(values)) < LARGEST).all():
            raise RobotError(
                f"{where}: a mass, inertia or origin at {name} is beyond {LARGEST:g}, expected "
                "values of an arm in SI units. Repair that body or its place in the file."
            )
    return model


def find_prismatic_joints(model: pin.Model) -> tuple[bool, ...]:
    """Return which joints of a model move along their axis, not about it."""
    kinds = list(model.joints)[1:]
    return tuple("JointModelP" in kind.shortname() for kind in kinds)


@contextmanager
def _captured_stderr(lines: list[str]) -> Iterator[None]:
    """Collect what C++ writes to file descriptor 2."""
    sys.stderr.flush()
    saved = os.dup(2)
    with tempfile.TemporaryFile() as sink:
        os.dup2(sink.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            sink.seek(0)
            lines.append(sink.read().decode(errors="replace"))


# The content of a robot.toml: names, units and sizes are checked.


Effects = Mapping[str, Collection[str]]

GRAVITY = (0.0, 0.0, -9.81)  # m/s^2
LARGEST = 1e30  # larger than any value of a robot; products of such values overflow
SLUG = re.compile(r"[a-z0-9_-]{1,40}")
SERIAL = re.compile(r"[A-Za-z0-9._-]{1,40}")
_TEXTS = {
    "name": (SLUG, "1 to 40 of a-z, 0-9, '_' and '-'"),
    "serial": (SERIAL, "a text of 1 to 40 letters, digits, '.', '_' and '-'"),
}
_TABLES = {
    "robot": ("name", "serial", "gravity", "gravcomp"),
    "joints": (
        "gear_ratio",
        "torque_per_unit",
        "torque_limit",
        "velocity_limit",
        "acceleration_limit",
    ),
    "couplings": ("motor_from_joint",),
    "prior": ("scale",),
}
_CHOICE = ("chain", "locked")  # read before, since sizes follow from them


@dataclass(frozen=True, eq=False, slots=True)
class DeclaredEffect:
    """An effect that the nominal model has."""

    # Its parameters by key, SI units. Shapes (dof,). Empty where the effect is declared
    # without values.
    values: Mapping[str, Array]
    assumed: bool = False  # whether the values are an assumption, not a measurement
    source: str = ""  # source of the values


def parse_toml(text: str, where: str) -> dict:
    """Parse the text of a robot.toml."""
    try:
        return check_nesting(tomllib.loads(text), where)
    except (RecursionError, InputError) as error:
        raise RobotError(f"{where} is nested too deep.") from error
    except ValueError as error:  # also a number of more digits than Python reads
        raise RobotError(f"{where} is not valid TOML: {error}.") from error


def parse_arm_choice(chain: object, locked: object, where: str) -> ArmChoice:
    """Check the chain and the locked joints of a robot.toml.

    Raises:
        RobotError: If a table is not one, or a name or value is not usable.
        UnknownNameError: On an unknown key.
    """
    for name, table in (("chain", chain), ("locked", locked)):
        if not isinstance(table, dict):
            raise RobotError(f"{where}: '{name}' must be a table: [{name}].")
    check_keys(chain, ("joints",), f"[chain] of {where}")
    joints = chain.get("joints", [])
    if not isinstance(joints, list) or not all(isinstance(j, str) for j in joints):
        raise _wrong_value(where, "joints of [chain]", joints, "a list of names")
    for joint, value in locked.items():
        if not _is_number(value):
            raise _wrong_value(where, f"{joint} in [locked]", value, "a position in rad or m")
    return ArmChoice(tuple(joints), None, (), dict(locked))


def parse_robot_settings(
    content: Mapping, dof: int, where: str, effects: Effects | None = None
) -> dict[str, Any]:
    """Check the content of a robot.toml.

    Args:
        effects: Parameters of each effect that may be declared; None to take any.

    Returns:
        Fields of a `Robot`, its gravity in the base frame [m/s^2], shape (3,), and
        whether a weight declared as compensated is.

    Raises:
        RobotError: On a wrong size or a value out of range.
        UnknownNameError: On an unknown table, key or effect.
    """
    check_keys(content, (*_TABLES, *_CHOICE, "declared", "known"), where)
    for name, table in content.items():
        if not isinstance(table, dict):
            raise RobotError(f"{where}: '{name}' must be a table: [{name}].")
        if name in _TABLES:
            check_keys(table, _TABLES[name], f"[{name}] of {where}")
    about = content.get("robot", {})
    if not isinstance(about.get("gravcomp", True), bool):
        expected = "true or false: whether what the MJCF states of it holds for the logs"
        raise _wrong_value(where, "gravcomp", about["gravcomp"], expected)
    return {
        **_joints(content.get("joints", {}), dof, where),
        "declared": _all_declared(content.get("declared", {}), dof, where, effects),
        "motor_from_joint": _coupling(content.get("couplings", {}), dof, where),
        "prior_scale": _scale(content.get("prior", {}), where),
        "known_values": _known_values(content.get("known", {}), f"[known] of {where}"),
        "name": _text(about, "name", where),
        "serial": _text(about, "serial", where),
        "gravcomp": about.get("gravcomp", True),
        "gravity": _array(about.get("gravity", GRAVITY), (3,), f"{where}: gravity"),
    }


def _joints(table: dict, dof: int, where: str) -> Mapping[str, Array]:
    arrays = {}
    for key, value in table.items():
        place = f"{where}: {key}"
        array = _array(value, (dof,), place)
        if key.endswith("_limit") and (array <= 0).any():
            raise RobotError(f"{place} must be positive, got {array.min():g}.")
        if (array == 0).any():
            raise RobotError(f"{place} must not be 0 for any joint.")
        arrays[key] = array
    return arrays


def _all_declared(
    tables: dict, dof: int, where: str, effects: Effects | None
) -> Mapping[str, DeclaredEffect]:
    out = {}
    for name, table in tables.items():
        if effects is not None:
            check_name(name, effects, f"effect in {where}")
        place = f"[declared.{name}] of {where}"
        if not isinstance(table, dict):
            raise RobotError(f"{where}: write {name} as a table [declared.{name}].")
        if effects is not None:
            check_keys(table, (*effects[name], "assumed", "source"), place)
        values = dict(table)
        assumed, source = values.pop("assumed", False), values.pop("source", "")
        if not isinstance(assumed, bool) or not isinstance(source, str):
            raise RobotError(f"{place}: assumed must be true or false, source a text.")
        if assumed and not source:
            raise RobotError(f"{place}: assumed values need a source = '...'.")
        arrays = {k: _array(v, (dof,), f"{place}: {k}") for k, v in values.items()}
        out[name] = DeclaredEffect(arrays, assumed, source)
    return out


def _coupling(table: dict, dof: int, where: str) -> Array | None:
    if "motor_from_joint" not in table:
        return None
    matrix = _array(table["motor_from_joint"], (dof, dof), f"{where}: motor_from_joint")
    if np.linalg.matrix_rank(matrix) < dof or (np.diag(matrix) == 0).any():
        raise RobotError(f"{where}: motor_from_joint must be invertible with no 0 on its diagonal.")
    return matrix


def _scale(table: dict, where: str) -> float | None:
    scale = table.get("scale", "estimate")
    if scale == "estimate":
        return None
    if not (_is_number(scale) and scale > 0):
        expected = "'estimate' or a positive number such as 0.03"
        raise _wrong_value(where, "prior scale", scale, expected)
    return float(scale)


def _known_values(table: dict, where: str) -> Mapping[str, float]:
    for word, value in table.items():
        if not _is_number(value):
            expected = 'a number, as in "payload.mass" = 2.8 (a name with dots stands in quotes)'
            raise _wrong_value(where, word, value, expected)
    return {word: float(value) for word, value in table.items()}


def _wrong_value(where: str, what: str, value: object, expected: str) -> RobotError:
    return RobotError(f"{where}: {what} is {quote_value(value)}, expected {expected}.")


def _is_number(value: object) -> bool:
    numeric = isinstance(value, int | float) and not isinstance(value, bool)
    return numeric and abs(value) < LARGEST


def _text(table: dict, key: str, where: str) -> str | None:
    """Return a name or serial number, None where there is none."""
    text = table.get(key)
    pattern, expected = _TEXTS[key]
    if text is not None and not (isinstance(text, str) and pattern.fullmatch(text)):
        raise _wrong_value(where, key, text, expected)
    return text


def _array(value: object, shape: tuple[int, ...], name: str) -> Array:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if array.shape != shape:
        size, got = (" x ".join(map(str, s)) for s in (shape, array.shape))
        raise RobotError(f"{name} needs {size} numbers, got {got or 'none'}.")
    if not np.isfinite(array).all():
        raise RobotError(f"{name} has a value that is not a finite number.")
    array.setflags(write=False)
    return array


_KINDS = {2: "prismatic", 3: "revolute"}  # mjtJoint; 0 is free, 1 a ball
_JOINT_EQUALITY = 2  # mjtEq


class CompiledMjcf(NamedTuple):
    """A compiled MJCF."""

    urdf: str
    gravity: tuple[float, ...] | None = None  # [m/s^2]
    # Properties of the joints, those of `residual.effects.base.Property`, by joint.
    properties: Mapping[str, Mapping[str, float]] = MappingProxyType({})
    notes: tuple[str, ...] = ()


def read_mjcf(path: Path) -> CompiledMjcf:
    """Compile an MJCF file and write it as a URDF.

    Raises:
        RobotError: If MuJoCo refuses it.
        InputError: If MuJoCo is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise build_missing_package_error("mujoco") from error
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, RuntimeError) as error:
        why = shorten_value(" ".join(str(error).split()))
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
        # Of each body: its link, and the placement of the body's frame in that of the link.
        self.frames: list[tuple[str, pin.SE3]] = []

    def compiled(self) -> CompiledMjcf:
        ET.SubElement(self.root, "link", {"name": "world"})
        self.frames.append(("world", pin.SE3.Identity()))
        for b in range(1, self.m.nbody):
            self._body(b)
        self._equalities()
        self._carried_weight()
        text = ET.tostring(self.root, encoding="unicode")
        gravity = tuple(float(g) for g in self.m.opt.gravity)
        return CompiledMjcf(text, gravity, self.properties, tuple(self.notes))

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
        """Move the pose from the joint's reference (MJCF) to zero (URDF)."""
        away = -float(self.m.qpos0[self.m.jnt_qposadr[j]]) * self.m.jnt_axis[j]
        if _KINDS[self.m.jnt_type[j]] == "prismatic":
            return pin.SE3(np.eye(3), np.array(away))
        return pin.SE3(pin.exp3(np.array(away)), np.zeros(3))

    def _joint(self, j: int, name: str, parent: str, link: str, place: pin.SE3) -> None:
        m, kind = self.m, _KINDS[self.m.jnt_type[j]]
        if kind == "revolute" and not m.jnt_limited[j]:
            kind = "continuous"
        node = ET.SubElement(self.root, "joint", {"name": name, "type": kind})
        _ends(node, parent, link, place)
        ET.SubElement(node, "axis", {"xyz": format_numbers(m.jnt_axis[j])})
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
            ET.SubElement(node, "origin", write_origin(place))
            ET.SubElement(node, "mass", {"value": repr(mass)})
            moments = zip(("ixx", "iyy", "izz"), self.m.body_inertia[b], strict=True)
            tensor = {key: repr(float(value)) for key, value in moments}
            tensor |= {"ixy": "0", "ixz": "0", "iyz": "0"}
            ET.SubElement(node, "inertia", tensor)

    def _carried_weight(self) -> None:
        """Record the share of the weight that is missing in the torque, and the joints."""
        m = self.m
        held = np.flatnonzero(m.body_gravcomp * m.body_mass)
        if not len(held):
            return
        names = [self.frames[b][0] for b in held]
        counted = np.flatnonzero(m.jnt_actgravcomp)
        node = ET.SubElement(self.root, "modelgap")
        for name, share in zip(names, m.body_gravcomp[held], strict=True):
            of = {"link": name, "share": repr(float(share))}
            ET.SubElement(node, GRAVCOMP, of)
        for j in counted:
            ET.SubElement(node, GRAVCOMP, {"joint": m.jnt(j).name or f"joint{j}"})
        own = "all joints" if len(counted) == m.njnt else f"{len(counted)} joints"
        self.notes.append(
            f"gravcomp: the weight of {abbreviate_list(names)} is held by a force "
            "beside the drives and missing from their torque (where the logs have it: "
            f"gravcomp = false in robot.toml, [robot])"
            + f"; {own} count it as their own"
            * bool(len(counted))
        )

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
    ET.SubElement(node, "origin", write_origin(place))
