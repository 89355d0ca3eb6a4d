"""A URDF text, checked, and turned into a Pinocchio model."""

import os
import re
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.errors import RobotError
from residual.recording import Array

ENDLESS = "1e4"  # rad: the range that a continuous joint is written with
_REFUSED = {
    "prismatic": "is prismatic",
    "floating": "is floating",
    "planar": "is planar",
}


@dataclass(frozen=True, eq=False, slots=True)
class Chain:
    """A serial arm as its URDF describes it.

    Attributes:
        name: Name of the robot in the file.
        text: The URDF, continuous joints written as revolute.
        lower: Lower end of each joint's range, -inf where continuous [rad]. (dof,).
        upper: Upper end of each joint's range, inf where continuous [rad]. (dof,).
        velocity_limit: Speed limit, inf where not given [rad/s]. Shape (dof,).
        torque_limit: Effort limit, inf where not given [N m]. Shape (dof,).
    """

    name: str
    text: str
    lower: Array
    upper: Array
    velocity_limit: Array
    torque_limit: Array


def read_chain(text: str, where: str) -> Chain:
    """Check a URDF and return its actuated joints in kinematic order.

    Raises:
        RobotError: If the text is not a URDF of a serial arm of revolute joints whose
            moving links have mass.
    """
    root = _parse(text, where)
    joints = _chain(root, where)
    _check_mass(root, joints, where)
    limits = np.array([_limits(joint, where) for joint in joints])
    continuous = [j for j in joints if j.get("type") == "continuous"]
    if continuous:
        text = _as_revolute(root, continuous)
    return Chain(root.get("name", ""), text, *limits.T)


def _parse(text: str, where: str) -> ET.Element:
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise RobotError(
            f"{where} does not parse as a URDF: {error}. Give a well-formed URDF file."
        ) from error
    if root.tag != "robot":
        raise RobotError(
            f"{where} is not a URDF: its root is <{root.tag}>, expected <robot>."
        )
    if any("xacro" in element.tag for element in root.iter()):
        raise RobotError(f"{where} is a xacro. Expand it to a plain URDF first.")
    return root


def _chain(root: ET.Element, where: str) -> list[ET.Element]:
    """Walk down from the root link; every actuated joint follows the one before."""
    children: dict[str, list[ET.Element]] = {}
    moved = set()
    for joint in root.findall("joint"):
        name = joint.get("name", "?")
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None:
            raise RobotError(f"{where}: joint '{name}' lacks a parent or a child link.")
        if child.get("link") in moved:
            raise RobotError(
                f"{where}: link '{child.get('link')}' hangs on two joints, expected a "
                "serial arm. Remove one of them."
            )
        children.setdefault(parent.get("link", ""), []).append(joint)
        moved.add(child.get("link"))
        _refuse(joint, where)
    bases = [n for n in _link_names(root) if n not in moved]
    if len(bases) != 1:
        raise RobotError(
            f"{where}: expected one base link, got {len(bases)} ({', '.join(bases)})."
        )
    order: list[ET.Element] = []
    front = children.get(bases[0], [])
    while front := _next_joints(front, children):
        if len(front) > 1:
            names = ", ".join(f"'{j.get('name')}'" for j in front)
            raise RobotError(
                f"{where} branches: joints {names} move on the same link, expected a "
                "serial arm. Make the joints of the side branch fixed."
            )
        order.append(front[0])
        front = children.get(front[0].find("child").get("link"), [])
    if not order:
        raise RobotError(f"{where} has no revolute joint, expected an arm.")
    return order


def _next_joints(front: list, children: dict[str, list]) -> list[ET.Element]:
    """Return the first actuated joints below, fixed joints passed through."""
    found, stack = [], list(front)
    while stack:
        joint = stack.pop(0)
        if joint.get("type") == "fixed":
            stack += children.get(joint.find("child").get("link"), [])
        else:
            found.append(joint)
    return found


def _refuse(joint: ET.Element, where: str) -> None:
    name, kind = joint.get("name", "?"), joint.get("type", "?")
    if joint.find("mimic") is not None:
        reason = "mimics another joint"
    elif kind in ("revolute", "continuous", "fixed"):
        return
    else:
        reason = _REFUSED.get(kind, f"has the unknown type '{kind}'")
    raise RobotError(
        f"{where}: joint '{name}' {reason}; only revolute, continuous and fixed joints "
        "are supported. Make it fixed or remove it."
    )


def _link_names(root: ET.Element) -> list[str]:
    return [link.get("name", "") for link in root.findall("link")]


def _check_mass(root: ET.Element, joints: list[ET.Element], where: str) -> None:
    """Every moving body needs mass, its fixed parts counted."""
    mass = {link.get("name"): _mass(link, where) for link in root.findall("link")}
    fixed: dict[str, list[str]] = {}
    for joint in root.findall("joint"):
        if joint.get("type") == "fixed":
            parent = joint.find("parent").get("link")
            fixed.setdefault(parent, []).append(joint.find("child").get("link"))
    for joint in joints:
        link = joint.find("child").get("link")
        body = [link]
        for part in body:
            body += fixed.get(part, [])
        if sum(mass.get(part, 0.0) for part in body) <= 0:
            raise RobotError(
                f"{where}: link '{link}', moved by joint '{joint.get('name')}', has no "
                "inertia. Give it an <inertial> with a positive mass."
            )


def _mass(link: ET.Element, where: str) -> float:
    node = link.find("inertial/mass")
    value = _number(node, "value", 0.0, f"{where}: mass of link '{link.get('name')}'")
    if value < 0:
        raise RobotError(
            f"{where}: link '{link.get('name')}' has mass {value:g}, expected >= 0."
        )
    return value


def _limits(joint: ET.Element, where: str) -> tuple[float, float, float, float]:
    """Return lower, upper, velocity and effort; a limit of 0 stands for not given."""
    node, name = joint.find("limit"), joint.get("name")
    axis = joint.find("axis")
    if axis is not None and not any(c in "123456789" for c in axis.get("xyz", "1")):
        raise RobotError(f"{where}: joint '{name}' has an axis of length zero.")
    what = f"{where}: limit of joint '{name}'"
    speed = _number(node, "velocity", 0.0, what) or np.inf
    effort = _number(node, "effort", 0.0, what) or np.inf
    if joint.get("type") == "continuous":
        return -np.inf, np.inf, speed, effort
    lower = _number(node, "lower", 0.0, what)
    upper = _number(node, "upper", 0.0, what)
    if upper == -lower == float(ENDLESS):
        return -np.inf, np.inf, speed, effort
    if lower >= upper:
        raise RobotError(
            f"{where}: joint '{name}' has no range (lower {lower:g}, upper {upper:g} "
            "rad). Give it a <limit> with lower below upper, or type continuous."
        )
    return lower, upper, speed, effort


def _number(node: ET.Element | None, key: str, default: float, what: str) -> float:
    text = default if node is None else node.get(key, default)
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise RobotError(f"{what}: {key} is '{text}', expected a finite number.")
    return value


def _as_revolute(root: ET.Element, joints: list[ET.Element]) -> str:
    # A continuous joint has two positions (cos, sin) for one velocity in Pinocchio; a
    # revolute one with a range of no consequence keeps q and qd the same size.
    for joint in joints:
        joint.set("type", "revolute")
        limit = joint.find("limit")
        if limit is None:
            limit = ET.SubElement(joint, "limit", {"effort": "0", "velocity": "0"})
        limit.set("lower", f"-{ENDLESS}")
        limit.set("upper", ENDLESS)
    return ET.tostring(root, encoding="unicode")


def build_model(text: str, where: str) -> pin.Model:
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
    # The parser goes on with a point mass where it cannot read an inertia.
    if model is None or "nertia" in noise[0]:
        reasons = re.findall(r"Error:\s+(.*)", "\n".join(noise))
        raise RobotError(
            f"{where} is not a usable URDF: {'; '.join(reasons[:2])[:180]}"
        )
    return model


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
