"""The robot: rigid body from its file, everything else from its robot.toml.

Also its reference: one word for its file and reading options, kept in requests and
records.
"""

import hashlib
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from urllib.parse import parse_qsl, urlencode

import numpy as np
import pinocchio as pin

from residual.errors import InputError, RobotError, UnknownNameError, check_name, shorten_value
from residual.recording import Array, Recording
from residual.robot.files import (
    GRAVITY,
    CompiledMjcf,
    DeclaredEffect,
    Effects,
    build_pinocchio_model,
    expand_xacro,
    find_prismatic_joints,
    parse_arm_choice,
    parse_robot_settings,
    parse_toml,
    read_mjcf,
)
from residual.robot.plausibility import (
    BodyFlaw,
    CarriedWeight,
    find_body_flaws,
    read_carried_weight,
    read_link_bodies,
    repair_impossible_bodies,
)
from residual.robot.urdf import UrdfArm, format_numbers, read_joint_link, read_urdf

# Effects, by the property of a joint that MJCF gives, with the parameter that it is.
Properties = Mapping[str, tuple[str, str]]
_MJCF = re.compile(r"(?>\s|<\?.*?\?>|<!--.*?-->|<!DOCTYPE[^>]*>)*+<mujoco\b", re.S)
_ENDINGS = (".urdf", ".xacro", ".xml")  # of robot files, in the order of their choice


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Robot:
    """A serial arm of revolute and prismatic joints, joint 1 at the base.

    Units follow the joint: a prismatic one has m and N in place of rad and N m.

    Attributes:
        name: Slug, 1 to 40 of a-z, 0-9, "_" and "-".
        model: Pinocchio model with nq == nv == dof, gravity set; impossible bodies of
            the file are replaced by the nearest possible ones.
        urdf: URDF text the model was built from: continuous joints as revolute, those
            outside of the chain as fixed.
        toml: Canonical text of the robot.toml (JSON, keys sorted), "{}" for none.
        dof: Number of joints.
        lower: Lower end of each range, -inf where continuous [rad]. Shape (dof,).
        upper: Upper end of each range, inf where continuous [rad]. Shape (dof,).
        velocity_limit: Speed limits, inf where unknown [rad/s]. Shape (dof,).
        torque_limit: Effort limits, inf where unknown [N m]. Shape (dof,).
        acceleration_limit: Acceleration limits [rad/s^2]. Shape (dof,) or None.
        gear_ratio: Motor turns per joint turn, signed. Shape (dof,) or None.
        torque_per_unit: Link torque per logged unit [N m]. Shape (dof,) or None.
        motor_from_joint: Motor speeds from joint speeds. Shape (dof, dof) or None.
        declared: Effects that the nominal model has, by name; empty for a bare URDF.
        prior_scale: Relative scale of the rigid prior, None to estimate it.
        serial: Serial number, None where its robot.toml gives none.
        columns: Column map of its logs in robot.toml, unchecked: a property of the
            logger, so not part of the robot's hash.
        known_values: Known values, such as "payload.mass" [SI].
        locked: Joints of its file outside of the chain, and their positions [rad or m].
        notes: Changes to the content of its file, in words.
        flaws: Implausible bodies of its file (`residual.robot.plausibility`).
        carried: Weight missing in the torque of its drives, by its file; None if they
            carry all.
    """

    name: str
    model: pin.Model
    urdf: str
    toml: str
    dof: int
    lower: Array
    upper: Array
    velocity_limit: Array
    torque_limit: Array
    acceleration_limit: Array | None = None
    gear_ratio: Array | None = None
    torque_per_unit: Array | None = None
    motor_from_joint: Array | None = None
    declared: Mapping[str, DeclaredEffect] = field(default_factory=dict)
    prior_scale: float | None = None
    serial: str | None = None
    columns: Mapping = field(default_factory=dict)
    known_values: Mapping[str, float] = field(default_factory=dict)
    locked: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    flaws: tuple[BodyFlaw, ...] = ()
    carried: CarriedWeight | None = None

    def __repr__(self) -> str:
        declared = ", ".join(self.declared) or "rigid body alone"
        names = ", ".join(self.joints)
        return f"Robot({self.name}: {self.dof} joints: {names}; declared: {declared})"

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints in the file, joint 1 first."""
        return tuple(self.model.names)[1:]

    @property
    def ends(self) -> tuple[Array, Array]:
        """Lower and upper ends of each range, of a joint without any one turn [rad]."""
        lower = np.where(np.isfinite(self.lower), self.lower, -np.pi)
        return lower, np.where(np.isfinite(self.upper), self.upper, np.pi)

    @property
    def prismatic(self) -> tuple[bool, ...]:
        """Which joints move along their axis, not about it."""
        return find_prismatic_joints(self.model)

    @property
    def content_hash(self) -> str:
        """SHA-256 of the URDF text and the robot.toml, hexadecimal."""
        return hashlib.sha256(f"{self.urdf}\0{self.toml}".encode()).hexdigest()

    @property
    def transmission(self) -> Array | None:
        """Motor speeds from joint speeds: couplings, else gears. (dof, dof) or None."""
        if self.motor_from_joint is None and self.gear_ratio is not None:
            return np.diag(self.gear_ratio)
        return self.motor_from_joint


def check_joint_count(robot: Robot, recordings: Sequence[Recording]) -> None:
    """Check that logs have the same number of joints."""
    for recording in recordings:
        if recording.dof != robot.dof:
            raise InputError(
                f"{recording.id} has {recording.dof} joints, {robot.name} has "
                f"{robot.dof}. Give the log's own robot with --robot."
            )


def list_built_in_robots() -> tuple[str, ...]:
    """Return the names of the robots that come with the program."""
    return tuple(sorted(f.name for f in find_built_in_folder().iterdir() if f.is_dir()))


def find_built_in_folder(name: str = "") -> Traversable:
    """Return the folder of a built-in robot; "" for the folder of all."""
    return files("residual") / "robot" / "built_in" / name


def load_robot(
    spec: str | Path,
    effects: Effects | None = None,
    properties: Properties | None = None,
    logged: Sequence[str] = (),
) -> Robot:
    """Load a robot.

    Args:
        spec: A built-in name, a folder with exactly one robot file (URDF, xacro or
            MJCF) and an optional robot.toml, or the file itself; reading options may
            follow (`parse_robot_reference`). A built-in name takes precedence over a
            folder of that name in the working directory.
        effects: Parameters of each effect that its robot.toml may declare
            (``residual.effects.list_effect_parameters``); None to take any.
        properties: Effects that the joints of an MJCF may have
            (``residual.effects.map_joint_properties``); None to leave them out.
        logged: Joint names in the logs, which select one of several chains if nothing
            else does.

    Raises:
        RobotError: If there is no such file or its content is not usable.
        UnknownNameError: On an unknown robot, table, key, effect, joint or link.
    """
    word, options = parse_robot_reference(spec)
    file, toml_file = _locate(word)
    content = parse_toml(_read(toml_file) if toml_file else "", "robot.toml")
    columns = content.pop("columns", {})
    if not isinstance(columns, dict):
        raise RobotError("robot.toml: 'columns' must be a table: [columns].")
    chain, locked = content.pop("chain", {}), content.pop("locked", {})
    choice = parse_arm_choice(chain, locked, "robot.toml")
    choice = replace(choice, logged=tuple(logged))
    if "tip" in options or "chain" in options:
        names = ",".join(options.get("chain", [])).split(",")
        joints = tuple(name.strip() for name in names if name)
        choice = replace(choice, joints=joints, tip=options.get("tip", [None])[0])
    text, path = _read(file), Path(str(file))
    compiled = CompiledMjcf(text)
    if path.suffix == ".xacro":
        text = expand_xacro(path, options.get("arg", ()), options.get("package", ()))
        compiled = CompiledMjcf(text)
    # A URDF may contain a <mujoco> element: the root determines the kind of a file.
    elif _MJCF.match(text):
        compiled = read_mjcf(path)
    arm = read_urdf(compiled.urdf, file.name, choice)
    # Declared values of an MJCF are treated like those of a robot.toml.
    if compiled.gravity not in (None, GRAVITY):
        content.setdefault("robot", {}).setdefault("gravity", list(compiled.gravity))
    source = {"assumed": True, "source": f"joint properties of {file.name}"}
    declared = properties if properties and compiled.properties else {}
    for key, (effect, parameter) in declared.items():
        values = [compiled.properties.get(key, {}).get(j, 0.0) for j in arm.joints]
        values_of = {parameter: values} | source if any(values) else {}
        content.setdefault("declared", {}).setdefault(effect, values_of)
    extra = parse_robot_settings(content, arm.limits.shape[1], "robot.toml", effects)
    if not extra["name"]:
        names = (re.sub(r"[^a-z0-9_-]+", "_", x.lower()) for x in (arm.name, path.stem))
        slugs = filter(None, (name.strip("_")[:40] for name in names))
        extra["name"] = next(slugs, "robot")
    extra |= {"toml": json.dumps(content, sort_keys=True), "columns": columns}
    notes = (*_beside(word, toml_file), *arm.notes, *compiled.notes)
    extra |= {"notes": notes, "locked": arm.locked}
    return _assemble(arm, extra, file.name)


@lru_cache(maxsize=16)
def build_robot(name: str, urdf: str, toml: str) -> Robot:
    """Build a robot from the texts of a `Robot`, without reading files."""
    arm = read_urdf(urdf, name)
    extra = parse_robot_settings(json.loads(toml), arm.limits.shape[1], name)
    return _assemble(arm, extra | {"name": name, "toml": toml}, name)


def set_serial_number(robot: Robot, serial: str | None) -> Robot:
    """Return the robot with a serial number.

    It is the same as with `serial` in its robot.toml, and has another hash than the
    robot without a number.

    Raises:
        RobotError: If it has another serial number, or this one is not usable.
    """
    if serial is None or robot.serial == serial:
        return robot
    if robot.serial is not None:
        raise RobotError(
            f"The robot.toml of {robot.name} has serial = '{robot.serial}', expected "
            f"'{shorten_value(serial)}'. Correct one of them, or describe each arm "
            f"apart."
        )
    return _with_table(robot, "robot", {"serial": serial})


def add_known_values(robot: Robot, values: Mapping[str, float]) -> Robot:
    """Return a robot with known values in addition to those of its file.

    Its description and hash are unchanged: it is the same arm.

    Args:
        values: By name, such as "payload.mass" or "coulomb.2.level" [SI].
    """
    if not values:
        return robot
    known = _with_table(robot, "known", values).known_values
    return replace(robot, known_values=known)


def refuse_carried_weight(robot: Robot, target: str) -> None:
    """Refuse an arm whose drives do not carry all of its weight.

    Raises:
        RobotError: If it is one, with the remedy.
    """
    if robot.carried is not None:
        raise RobotError(
            f"{robot.name} has a weight that its drives do not carry (gravcomp of its "
            f"MJCF), and {target} knows none. Leave gravcomp out of the file, or give "
            "gravcomp = false in robot.toml, [robot]: then its drives carry all."
        )


def replace_gravity(robot: Robot, gravity: Sequence[float]) -> Robot:
    """Return a robot with another mounting: gravity in the base frame [m/s^2]."""
    return _with_table(robot, "robot", {"gravity": [float(g) for g in gravity]})


def _with_table(robot: Robot, table: str, more: Mapping) -> Robot:
    """The robot with more in a table of its robot.toml."""
    content = json.loads(robot.toml)
    content[table] = content.get(table, {}) | dict(more)
    text = json.dumps(content, sort_keys=True)
    robot_new = build_robot(robot.name, robot.urdf, text)
    # In the order of its file, which is that of the columns of a fit: a rerun from the stored
    # file has the same bits.
    declared = {name: robot_new.declared[name] for name in robot.declared}
    return replace(
        robot_new, columns=robot.columns, declared=declared, locked=robot.locked, notes=robot.notes
    )


def _assemble(arm: UrdfArm, extra: dict, where: str) -> Robot:
    """Combine both files; limits in robot.toml take precedence over the URDF."""
    lower, upper, speed, effort = arm.limits
    dof, model = len(lower), build_pinocchio_model(arm.urdf, where)
    if model.nq != dof or model.nv != dof:
        raise RobotError(
            f"{where}: {model.nq} positions for {dof} joints, expected as many. "
            "Report this URDF as a bug."
        )
    if arm.flange:  # as the last frame, which `find_flange_frame` takes
        body = model.frames[model.getFrameId(arm.flange, pin.FrameType.BODY)]
        place = (body.name, body.parentJoint, body.placement, pin.FrameType.OP_FRAME)
        model.addFrame(pin.Frame(*place), append_inertia=False)
    model.gravity.linear = extra.pop("gravity")
    bodies = read_link_bodies(model, arm.urdf)
    flaws = find_body_flaws(model, bodies)
    model = repair_impossible_bodies(model, bodies, flaws)
    limits = {"velocity_limit": speed, "torque_limit": effort, "flaws": flaws}
    limits["carried"] = None
    if extra.pop("gravcomp"):
        limits["carried"] = read_carried_weight(model, arm.urdf, bodies)
    parts = {"model": model, "urdf": arm.urdf, "lower": lower, "upper": upper}
    return Robot(dof=dof, **parts, **limits | extra)


def _locate(spec: str | Path) -> tuple[Traversable, Traversable | None]:
    """Return the URDF and the robot.toml of a robot reference."""
    path = Path(spec)
    if str(spec) not in list_built_in_robots():
        try:
            path.stat()
        except (FileNotFoundError, NotADirectoryError, ValueError):
            pass  # said below
        except OSError as error:
            raise RobotError(f"Robot '{shorten_value(spec)}': {error.strerror}.") from error
        if path.is_dir():
            return _only_file(path)
        if path.is_file():
            return path, _toml_beside(path)
        if path.exists() or path.suffix or len(path.parts) > 1:
            raise RobotError(
                f"No file or folder '{shorten_value(spec)}' for a robot. Give a URDF, "
                "xacro or MJCF file, a folder with one, or a built-in name "
                f"({', '.join(list_built_in_robots())})."
            )
    try:
        name = check_name(str(spec), list_built_in_robots(), "robot")
    except UnknownNameError as error:
        more = "Or give a URDF, xacro or MJCF file, or a folder with one."
        raise UnknownNameError(f"{error} {more}") from None
    return _only_file(find_built_in_folder(name))


def _toml_beside(path: Path) -> Path | None:
    """Return the robot.toml beside a robot file, in a folder without another arm."""
    toml = path.with_name("robot.toml")
    same = [f for f in path.parent.glob(f"*{path.suffix}") if f.is_file()]
    return toml if len(same) == 1 and toml.is_file() else None


def _beside(word: str, toml: Traversable | None) -> tuple[str, ...]:
    """Return a note on a robot.toml beside a file given by its name."""
    given = Path(word)
    if not given.is_file() or not given.with_name("robot.toml").is_file():
        return ()
    if toml:
        return (f"with the robot.toml beside {given.name}",)
    return (f"robot.toml is not read: others are beside {given.name}; part them",)


def _only_file(folder: Traversable) -> tuple[Traversable, Traversable | None]:
    """Return the robot file of a folder, a URDF if there is one, and robot.toml."""
    entries = {f.name: f for f in folder.iterdir() if f.is_file()}
    by_ending = [sorted(n for n in entries if n.endswith(e)) for e in _ENDINGS]
    robots = next(filter(None, by_ending), [])
    if len(robots) != 1:
        listed = ", ".join(robots) or "none"
        raise RobotError(
            f"Folder '{folder.name}' must hold exactly one robot file (*.urdf, *.xacro "
            f"or *.xml), found {listed}. Give the file itself to choose one."
        )
    return entries[robots[0]], entries.get("robot.toml")


def _read(file: Traversable) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise RobotError(f"{file.name} is not a text file, expected UTF-8 text.") from error
    except OSError as error:
        raise RobotError(f"Cannot read {file.name}: {error.strerror}.") from error


def write_urdf_with_inertias(robot: Robot, parameters: Array) -> str:
    """Return the robot's URDF with other inertial parameters.

    The full inertia of a moving body is assigned to the link that its joint moves; parts
    fixed to it keep their geometry and lose their inertia.

    Args:
        parameters: Ten per moving body, Pinocchio's order [SI]. Shape (10 dof,).

    Raises:
        InputError: If a mass is not positive, which URDF does not allow.
        RobotError: If the drives do not carry all of its weight.
    """
    refuse_carried_weight(robot, "a URDF")
    root = ET.fromstring(robot.urdf)
    joints = {j.get("name", ""): j for j in root.findall("joint")}
    links = {link.get("name", ""): link for link in root.findall("link")}
    bodies = zip(robot.joints, np.reshape(parameters, (-1, 10)), strict=True)
    for number, (name, body) in enumerate(bodies, start=1):
        if not body[0] > 0:
            raise InputError(
                f"Link {number} was identified with mass {body[0]:.3g} kg, and a URDF "
                "needs a positive one. Use --consistent, which keeps bodies possible."
            )
        body_link = read_joint_link(joints[name], "child")
        parts = [body_link]  # and all links fixed to it, directly or through others
        for part in parts:
            parts += [
                read_joint_link(j, "child")
                for j in joints.values()
                if j.get("type") == "fixed" and read_joint_link(j, "parent") == part
            ]
            inertial = links[part].find("inertial")
            if inertial is not None:
                links[part].remove(inertial)
        links[body_link].insert(0, _inertial(body))
        if not np.isfinite(robot.lower[number - 1]):
            # Restore continuous joints, which the reader changed.
            joints[name].set("type", "continuous")
            limit = joints[name].find("limit")
            for side in ("lower", "upper") if limit is not None else ():
                limit.attrib.pop(side, None)
    return ET.tostring(root, encoding="unicode") + "\n"


def _inertial(body: Array) -> ET.Element:
    """Mass, centre and the tensor about the centre, in the link's own axes."""
    inertia = pin.Inertia.FromDynamicParameters(body)
    node = ET.Element("inertial")
    xyz = format_numbers(inertia.lever)
    ET.SubElement(node, "origin", {"xyz": xyz, "rpy": "0 0 0"})
    ET.SubElement(node, "mass", {"value": repr(float(inertia.mass))})
    places = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2)}
    places["zz"] = (2, 2)
    tensor = inertia.inertia
    tensors = {f"i{key}": repr(float(tensor[at])) for key, at in places.items()}
    ET.SubElement(node, "inertia", tensors)
    return node


_OPTIONS = ("chain", "tip", "arg", "package")


def format_robot_reference(
    robot: str | Path,
    chain: Sequence[str] = (),
    tip: str | None = None,
    args: Sequence[str] = (),
    packages: Sequence[str] = (),
) -> str:
    """Return one word for a robot file and its reading options: "arm.urdf#tip=flange".

    Args:
        chain: Names of the joints of the arm.
        tip: The link that the arm ends with.
        args: Arguments of a xacro, as "name:=value".
        packages: Folders searched for its packages.
    """
    pairs = [("chain", ",".join(chain)), ("tip", tip or "")]
    pairs += [("arg", word) for word in args] + [("package", p) for p in packages]
    options = urlencode([(key, value) for key, value in pairs if value], safe=",:=/")
    return f"{robot}#{options}" if options else str(robot)


def parse_robot_reference(spec: str | Path) -> tuple[str, dict[str, list[str]]]:
    """Return the file and the reading options of a robot reference."""
    word, out = str(spec), dict[str, list[str]]()
    place, sign, text = word.rpartition("#")
    options = parse_qsl(text)
    if not sign or not options or any(key not in _OPTIONS for key, _ in options):
        return word, out
    for key, value in options:
        out.setdefault(key, []).append(value)
    return place, out
