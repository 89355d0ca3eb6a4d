"""A URDF with other inertias: what was identified, written back where it came from."""

import xml.etree.ElementTree as ET

import numpy as np

from residual.errors import InputError
from residual.recording import Array
from residual.robot.robot import Robot


def with_inertials(robot: Robot, parameters: Array) -> str:
    """Return the robot's URDF with other inertial parameters.

    The whole inertia of a moving body goes to the link that its joint moves; parts
    that are fixed to it keep their geometry and lose their own inertia.

    Args:
        parameters: Ten per moving body, Pinocchio's order [SI]. Shape (10 dof,).

    Raises:
        InputError: If a mass is not positive: no URDF can hold it.
    """
    root = ET.fromstring(robot.urdf)
    joints = {j.get("name", ""): j for j in root.findall("joint")}
    links = {link.get("name", ""): link for link in root.findall("link")}
    names = list(robot.model.names)[1:]
    bodies = np.reshape(parameters, (-1, 10))
    for number, (name, body) in enumerate(zip(names, bodies, strict=True), start=1):
        if not body[0] > 0:
            raise InputError(
                f"Link {number} was identified with mass {body[0]:.3g} kg, and a URDF "
                "needs a positive one. Use --consistent, which keeps bodies possible."
            )
        moved = _end(joints[name], "child")
        for part in _fixed_to(moved, joints):
            own = links[part].find("inertial")
            if own is not None:
                links[part].remove(own)
        _replace(links[moved], body)
        if not np.isfinite(robot.lower[number - 1]):
            _make_continuous(joints[name])
    return ET.tostring(root, encoding="unicode") + "\n"


def _fixed_to(link: str, joints: dict[str, ET.Element]) -> list[str]:
    """Links that are fixed to a link, directly or through others."""
    found = [link]
    for part in found:
        found += [
            _end(j, "child")
            for j in joints.values()
            if j.get("type") == "fixed" and _end(j, "parent") == part
        ]
    return found[1:]


def _end(joint: ET.Element, side: str) -> str:
    """Name of the parent or child link; the reader has seen that there is one."""
    node = joint.find(side)
    return "" if node is None else node.get("link", "")


def _make_continuous(joint: ET.Element) -> None:
    """Undo what the reader did to a joint without ends (``urdf``)."""
    joint.set("type", "continuous")
    limit = joint.find("limit")
    if limit is not None:
        limit.attrib.pop("lower", None)
        limit.attrib.pop("upper", None)


def _replace(link: ET.Element, body: Array) -> None:
    """Write mass, centre and the tensor about the centre, in the link's own axes."""
    own = link.find("inertial")
    if own is not None:
        link.remove(own)
    mass, centre = body[0], body[1:4] / body[0]
    xx, xy, yy, xz, yz, zz = body[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    shift = centre @ centre * np.eye(3) - np.outer(centre, centre)
    tensor = about_origin - mass * shift
    node = ET.Element("inertial")
    xyz = " ".join(_number(c) for c in centre)
    ET.SubElement(node, "origin", {"xyz": xyz, "rpy": "0 0 0"})
    ET.SubElement(node, "mass", {"value": _number(mass)})
    places = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2)}
    places["zz"] = (2, 2)
    tensors = {f"i{key}": _number(tensor[at]) for key, at in places.items()}
    ET.SubElement(node, "inertia", tensors)
    link.insert(0, node)


def _number(value: float) -> str:
    """All digits that a double has."""
    return repr(float(value))
