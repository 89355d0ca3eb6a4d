"""A model for simulators: as URDF, and as MJCF for MuJoCo 4 and compatible programs.

Written as text with all digits of a double; MuJoCo's own writer keeps six. Dry friction
is a soft constraint there, and under its usual settings it reaches a per cent of its
value or less at 1e-3 rad/s; under those written here it reaches all of it.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Collection
from dataclasses import replace

import numpy as np
import pinocchio as pin

from residual.effects.base import EffectTrait
from residual.errors import InputError
from residual.export.c99 import (
    explain_missing_formula,
    fill_template,
    make_c_identifier,
    read_template,
    write_c_header,
)
from residual.export.model_export import (
    RATE,
    SECONDS,
    AnyModel,
    ModelExport,
    add_effect_bodies,
    build_reference_motion,
    make_file_stem,
    remove_tables,
    split_exportable_terms,
)
from residual.model.dynamics import compute_model_mass_matrix
from residual.model.model import LEAST_SPEED, Model, Term
from residual.recording import Array
from residual.robot.dynamics import build_kinematic_chain
from residual.robot.robot import refuse_carried_weight, write_urdf_with_inertias
from residual.robot.urdf import format_numbers

NOT_NEGATIVE = ("damping", "quadratic_damping", "friction", "armature", "stiffness")
URDF_CAN = ("damping", "friction")
MJCF_CAN = ("damping", "quadratic_damping", "friction", "armature", "stiffness", "constant")
STEP = 0.001  # s
THICK = 0.03  # m, of the lines that stand for links


def split_joint_properties(
    source: AnyModel, target: str, supported_properties: Collection[str], gravity: bool = False
) -> ModelExport:
    """Separate terms that joints and bodies of a target can represent from others."""
    model = remove_tables(source)
    refuse_carried_weight(model.robot, target)
    total = sum_joint_properties(model)

    def refuse(term: Term) -> str:
        said = term.effect.portable
        if said.bodies or (gravity and said.gravity):
            return ""
        if not said.joint or not set(said.joint) <= set(supported_properties):
            return f"{target} cannot represent it"
        (joint,) = term.joints
        units = term.effect.units(term.joints, model.robot).values()
        for name, unit in zip(said.joint, units, strict=False):
            if name in NOT_NEGATIVE and total[name][joint] < 0:
                return (
                    f"{target} allows no negative {name}, got "
                    f"{total[name][joint]:.3g} {unit}: `modelgap identify` gives its "
                    "standard deviation; --prior 0.03 keeps it near its nominal value"
                )
        # A constant torque is a spring with another rest position.
        lone = "constant" in said.joint and not total["stiffness"][joint] > 0
        return f"{target} has no constant torque on a joint" if lone else ""

    return split_exportable_terms(source, refuse, f"{target} has no tables")


def sum_joint_properties(model: Model) -> dict[str, Array]:
    """Return the properties of the joints, those of all terms added. (dof,) each."""
    names = (*NOT_NEGATIVE, "constant")
    out = {name: np.zeros(model.robot.dof) for name in names}
    for term in model.terms:
        for name, value in zip(term.effect.portable.joint, term.theta, strict=False):
            out[name][list(term.joints)] += value
    return out


def to_urdf(source: AnyModel) -> ModelExport:
    """Return a model as a URDF, which cannot hold gravity or effects of the drives.

    Raises:
        InputError: If a link has no positive mass.
    """
    made = split_joint_properties(source, "URDF", URDF_CAN)
    model = remove_tables(made.carried)
    root = ET.fromstring(write_urdf_with_inertias(model.robot, add_effect_bodies(model)))
    joints = {j.get("name"): j for j in root.findall("joint")}
    values = sum_joint_properties(model)
    for number, name in enumerate(model.robot.joints):
        joint = joints[name]
        for old in joint.findall("dynamics"):
            joint.remove(old)
        own = {key: repr(float(values[key][number])) for key in URDF_CAN}
        ET.SubElement(joint, "dynamics", own)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode") + "\n"
    return replace(made, files={f"{make_file_stem(source)}.urdf": text.encode()})


# Twice the time step is the smallest time constant that MuJoCo allows.
FRICTION = {"solreffriction": f"{2 * STEP} 1", "solimpfriction": "0.9999 0.9999 0.001 0.5 2"}


def to_mjcf(source: AnyModel, supported_properties: Collection[str] = MJCF_CAN) -> ModelExport:
    """Return a model as an MJCF, with a motor on each joint and lines as geometry.

    Args:
        supported_properties: Which properties of joints to use.

    Raises:
        InputError: If a link is none that MuJoCo takes.
    """
    made = split_joint_properties(source, "MJCF", supported_properties, gravity=True)
    model = remove_tables(made.carried)
    root = ET.Element("mujoco", {"model": model.robot.name})
    ET.SubElement(root, "compiler", {"angle": "radian", "inertiafromgeom": "false"})
    gravity = np.array(model.robot.model.gravity.linear)
    for term in model.terms:
        if add := term.effect.portable.gravity:
            gravity = gravity + add(term.theta, model.robot)
    options = {"timestep": repr(STEP), "gravity": format_numbers(gravity)}
    ET.SubElement(root, "option", options | {"integrator": "implicitfast"})
    default = ET.SubElement(root, "default")
    ET.SubElement(default, "joint", FRICTION)
    seen = {"contype": "0", "conaffinity": "0", "mass": "0"}
    ET.SubElement(default, "geom", {"type": "capsule", **seen})
    _bodies(ET.SubElement(root, "worldbody"), model)
    motors = ET.SubElement(root, "actuator")
    for name, most in zip(model.robot.joints, model.robot.torque_limit, strict=True):
        motor = {"name": f"motor_{name}", "joint": name}
        if np.isfinite(most):
            motor |= {"ctrllimited": "true", "ctrlrange": format_numbers([-most, most])}
        ET.SubElement(motors, "motor", motor)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode") + "\n"
    return replace(made, files={f"{make_file_stem(source)}.xml": text.encode()})


def _bodies(parent: ET.Element, model: Model) -> None:
    chain, values = (build_kinematic_chain(model.robot.model), sum_joint_properties(model))
    bodies = add_effect_bodies(model).reshape(-1, 10)
    for i, name in enumerate(model.robot.joints):
        if i:
            _line(parent, chain.place[i])
        place = {"pos": format_numbers(chain.place[i]), "quat": _quaternion(chain.rotation[i])}
        parent = ET.SubElement(parent, "body", {"name": f"link_{i + 1}", **place})
        ET.SubElement(parent, "inertial", _inertial(bodies[i], i + 1))
        kind = "slide" if chain.slides[i] else "hinge"
        joint = {"name": name, "type": kind, "axis": format_numbers(chain.axis[i])}
        joint |= {
            "armature": repr(float(values["armature"][i])),
            "frictionloss": repr(float(values["friction"][i])),
            "damping": format_numbers([values["damping"][i], values["quadratic_damping"][i]]),
        }
        if stiffness := float(values["stiffness"][i]):
            rest = -float(values["constant"][i]) / stiffness
            joint |= {"stiffness": repr(stiffness), "springref": repr(rest)}
        lower, upper = model.robot.lower[i], model.robot.upper[i]
        if np.isfinite(lower):
            joint |= {"limited": "true", "range": format_numbers([lower, upper])}
        ET.SubElement(parent, "joint", joint)
    place = {"pos": format_numbers(chain.flange), "quat": _quaternion(chain.flange_rotation)}
    _line(parent, chain.flange)
    ET.SubElement(parent, "site", {"name": "flange", **place})


def _inertial(body: Array, number: int) -> dict[str, str]:
    """Mass, center and inertia about the center, in the axes of the joint."""
    moved = pin.Inertia.FromDynamicParameters(body)
    mass, centre, tensor = moved.mass, moved.lever, moved.inertia
    least, middle, most = np.linalg.eigvalsh(tensor)
    if not least > 0 or least + middle < most * (1 - 1e-9):
        raise InputError(
            f"Link {number} has principal inertias {least:.3g}, {middle:.3g} and "
            f"{most:.3g} kg m^2 in this model, which no body has, and MuJoCo refuses "
            "it. Identify it with --consistent, or export it to c99."
        )
    places = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    full = format_numbers([tensor[at] for at in places])
    return {"pos": format_numbers(centre), "mass": repr(float(mass)), "fullinertia": full}


def _line(parent: ET.Element, end: Array) -> None:
    """A massless line to the next joint, so that the arm is visible."""
    if np.linalg.norm(end) > THICK:
        ends = format_numbers([0, 0, 0, *end])
        ET.SubElement(parent, "geom", {"fromto": ends, "size": repr(THICK)})


def _quaternion(rotation: Array) -> str:
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return format_numbers([w, x, y, z])


SOURCE = "passive.py.txt"
# The callback computes dry friction: MuJoCo's joint friction is discontinuous and sticks,
# the model's does not, and over seconds the arms would differ by tenths of a milliradian.
NATIVE = tuple(name for name in MJCF_CAN if name != "friction")
REPORT = "it distorts the torque reading only, not the motion"
# Relative to the time constant of friction at reversals: an explicit force is stable below
# 2.
SHARE, SHORTEST = 1.0, 2e-5  # 1, s
POSES = 8  # states for finding the time step


def to_mujoco(source: AnyModel) -> ModelExport:
    """Return an MJCF, headers of the model and of its MJCF part, and a Python module.

    MJCF holds what it can represent; the module compiles the headers and adds the other
    terms (Stribeck friction, load friction, ripple, tables) as passive force.

    Raises:
        InputError: If a link is none that MuJoCo takes.
    """
    made = split_exportable_terms(
        source,
        lambda t: REPORT if EffectTrait.REPORT in t.effect.traits else explain_missing_formula(t),
    )
    mjcf, stem = to_mjcf(made.carried, NATIVE), make_file_stem(source)
    robot = replace(remove_tables(source).robot, name=f"{stem}_native")
    native = replace(remove_tables(mjcf.carried), robot=robot)
    name, (text,) = make_c_identifier(stem), mjcf.files.values()
    full, memory = write_c_header(made.carried, made.omissions)
    in_mjcf, native_memory = write_c_header(native)
    added = (x.name + "".join(f" J{j}" for j in x.joints) for x in mjcf.omissions)
    words = {
        "NAME": stem,
        "STEM": stem,
        "P": name,
        "DOF": str(robot.dof),
        "MEMORY": str(max(memory, native_memory, 1)),
        "ADDED": ", ".join(added) or "nothing, all is in the MJCF",
        "LEFT": ",\n    ".join(map(str, made.omissions)) or "nothing is left out",
    }
    step = f'timestep="{find_stable_time_step(remove_tables(made.carried), native)!r}"'
    files = {
        f"{stem}.xml": re.sub(r'timestep="[^"]*"', step, text.decode()).encode(),
        f"{name}.h": full.encode(),
        f"{name}_native.h": in_mjcf.encode(),
        f"{name}_passive.py": fill_template(read_template(SOURCE), words).encode(),
    }
    return replace(made, files=files)


def find_stable_time_step(model: Model, native_part: Model) -> float:
    """Return a time step at which the explicit friction of the callback is stable [s].

    The slope of friction over a small speed, and the inertia of a joint with all others
    free, give the time constant in which it stops a motion.
    """
    q = build_reference_motion(model.robot).q[:: round(SECONDS * RATE / POSES)]
    floor = model.speed_floor
    small = 0.05 * (LEAST_SPEED if floor is None else float(np.min(floor)))
    slope, still = np.zeros_like(q), np.zeros_like(q)
    t = np.arange(float(len(q)))
    for part, sign in ((model, 1.0), (native_part, -1.0)):
        terms = tuple(t for t in part.terms if EffectTrait.REPORT not in t.effect.traits)
        part = replace(part.replace_bristles_by_sign(), terms=terms)
        for j in range(q.shape[1]):
            qd = still.copy()
            qd[:, j] = small
            ends = [part.along(t, (q, x, still))[:, j] for x in (qd, -qd)]
            slope[:, j] += sign * (ends[0] - ends[1]) / (2 * small)
    mass = compute_model_mass_matrix(model, q)
    if not np.linalg.eigvalsh(mass)[:, 0].min() > 0:
        raise InputError(
            "M(q) of the model is not positive definite, and MuJoCo cannot move it. "
            "Identify it with --consistent, or export it to c99."
        )
    fastest = float(np.abs(slope * np.einsum("nii->ni", np.linalg.inv(mass))).max())
    return float(max(SHORTEST, min(STEP, SHARE / max(fastest, 1e-9))))
