"""A URDF: the choice of the arm's joints, and the file with all others locked.

A robot file may contain more than an arm: fingers, a second arm, a lift, wheels. The arm
is one chain of revolute, continuous and prismatic joints. Every other joint is written as
a fixed one at its locked position, so that every program (Pinocchio, PyBullet, MuJoCo, a
controller) reads a serial arm that carries the other links: the reduced model of
Pinocchio.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from residual.errors import RobotError, check_name
from residual.recording import Array

ENDLESS = "1e4"  # rad or m: written range of a continuous joint
MOVING = ("revolute", "continuous", "prismatic")
# In <modelgap>, our element: for a link the share of its weight that a force other than the
# drives carries, for a joint that its drive includes that share.
GRAVCOMP = "gravcomp"
# Joints before a branch with fewer joints, from which that branch counts as a hand.
TRUNK = 3
_NAMED = 6  # joints listed in a line
_FAULTS = 8  # faults of a file, in one message


class UrdfArm(NamedTuple):
    """A serial arm from its file, with ranges for continuous joints.

    Limits are lower, upper [rad or m], speed [rad/s or m/s] and effort [N m or N] of
    each joint, infinite where not given or continuous. Shape (4, dof).
    """

    name: str
    urdf: str
    limits: Array
    joints: tuple[str, ...]  # names of the chain, base to tip
    locked: Mapping[str, float]  # joints outside of the chain [rad or m]
    notes: tuple[str, ...]  # changes to the content of the file, in words
    flange: str  # link of the flange, "" for the last one that the last joint moves


@dataclass(frozen=True, slots=True)
class ArmChoice:
    """The choice of the arm's joints in a file, and the positions of the others."""

    joints: tuple[str, ...] = ()  # names, in any order; () if not given
    tip: str | None = None  # the last link of the arm
    logged: tuple[str, ...] = ()  # joint names in the logs
    locked: Mapping[str, float] = field(default_factory=dict)  # [rad or m]


class _Tree:
    """The links and joints of a file, and their faults."""

    def __init__(self, root: ET.Element) -> None:
        self.faults: list[str] = []
        self.notes: list[str] = []
        self.links = self._by_name(root, "link")
        self.joints = self._by_name(root, "joint")
        self.above: dict[str, ET.Element] = {}  # the parent joint of a link
        self.below: dict[str, list[ET.Element]] = {}
        for name, joint in self.joints.items():
            self._place(name, joint)
        self._drop_loose(root)
        self.mimics = {  # mimic joints
            name: joint
            for name, joint in self.joints.items()
            if joint.find("mimic") is not None and joint.get("type") in MOVING
        }

    def _by_name(self, root: ET.Element, kind: str) -> dict[str, ET.Element]:
        elements: dict[str, ET.Element] = {}
        for element in root.findall(kind):
            name = element.get("name", "?")
            if name in elements:
                self.faults.append(f"{kind} '{name}' is not unique")
            elements.setdefault(name, element)
        return elements

    def _place(self, name: str, joint: ET.Element) -> None:
        kind = joint.get("type", "?")
        if kind not in (*MOVING, "fixed", "floating", "planar"):
            self.faults.append(f"joint '{name}' has the unknown type '{kind}'")
        parent, child = (read_joint_link(joint, side) for side in ("parent", "child"))
        if not parent or not child:
            self.faults.append(f"joint '{name}' lacks a parent or a child link")
            return
        for link in {parent, child} - set(self.links):
            self.faults.append(
                f"joint '{name}' is at link '{link}', which is not found in the file"
            )
        if child in self.above:
            self.faults.append(f"link '{child}' hangs on two joints")
        self.above[child] = joint
        self.below.setdefault(parent, []).append(joint)

    def _drop_loose(self, root: ET.Element) -> None:
        """Remove unattached links, if one base link with joints remains."""
        bases = [name for name in self.links if name not in self.above]
        moving = [name for name in bases if self.moved_by(self.below.get(name, []))]
        if len(bases) > 1 and len(moving) == 1:
            lost = [link for b in bases if b != moving[0] for link in self.carried(b)]
            for name in lost:
                for element in (self.links.pop(name), self.above.pop(name, None)):
                    if element is not None:
                        root.remove(element)
            kept = {j.get("name", "?") for j in self.above.values()}
            self.joints = {n: j for n, j in self.joints.items() if n in kept}
            self.notes.append(f"left out, since it hangs on no joint: {abbreviate_list(lost)}")
            bases = moving
        if len(bases) != 1 and not self.faults:
            which = f"{len(bases)} ({', '.join(bases)})" if bases else "none"
            self.faults.append(f"expected one base link, got {which}")
        ring = set(self.links).difference(*map(self.carried, bases))
        if ring:
            self.faults.append(f"links hang on each other: {abbreviate_list(sorted(ring))}")

    def carried(self, link: str, stop: Iterable[str] = ()) -> list[str]:
        """The link and all its descendants, except those beyond some joints."""
        links, stop = [link], set(stop)
        for part in links:
            on = [j for j in self.below.get(part, []) if j.get("name") not in stop]
            links += [c for j in on if (c := read_joint_link(j, "child")) not in links]
        return links

    def moved_by(self, front: Sequence[ET.Element]) -> list[ET.Element]:
        """The first movable joints below a link, passing through fixed ones."""
        joints, stack = [], list(front)
        while stack:
            joint = stack.pop(0)
            if joint.get("type") in MOVING:
                joints.append(joint)
            else:
                stack += self.below.get(read_joint_link(joint, "child"), [])
        return joints

    def last_link(self, link: str, stop: Iterable[str] = ()) -> str:
        """The last link of `carried` in the order of Pinocchio: children by joint name."""
        names = {j.get("name", "?"): j for j in self.below.get(link, [])}
        open_names = names.keys() - set(stop)
        if not open_names:
            return link
        return self.last_link(read_joint_link(names[max(open_names)], "child"), stop)

    def path(self, link: str) -> list[str]:
        """Names of the movable joints from the base to a link, in order."""
        names: list[str] = []
        while link in self.above:
            joint = self.above[link]
            if joint.get("type") in MOVING:
                names.insert(0, joint.get("name", "?"))
            link = read_joint_link(joint, "parent")
        return names

    def vector(self, node: ET.Element | None, key: str, default: str, name: str) -> Array:
        """Three numbers of an attribute. Shape (3,)."""
        text = default if node is None else node.get(key, default)
        try:
            return np.array(text.split(), dtype=float).reshape(3)
        except ValueError:
            self.faults.append(f"{name}: {key} is '{text}', expected three numbers")
            return np.zeros(3)

    def number(self, node: ET.Element | None, key: str, name: str) -> float:
        text = "0" if node is None else node.get(key, "0")
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if np.isnan(value):
            self.faults.append(f"{name}: {key} is '{text}', expected a finite number")
            return 0.0
        return value


def read_urdf(text: str, where: str, choice: ArmChoice | None = None) -> UrdfArm:
    """Check a URDF, choose its arm, and lock all joints outside of it.

    Args:
        choice: Which joints are the arm; None for the only one there is.

    Raises:
        RobotError: If the text is no valid URDF, with all its faults; or if it has no
            arm, or several without a choice.
        UnknownNameError: On an unknown joint or link.
    """
    choice = choice or ArmChoice()
    root = _parse(text, where)
    tree = _Tree(root)
    if tree.faults:  # with those of bodies and joints, which need no chain
        for joint in (j for j in tree.joints.values() if j.get("type") in MOVING):
            _limits(tree, joint)
        _check_bodies(tree, ())
    _refuse(tree.faults, where)
    chain = _chain(tree, choice, where)
    locked = _locked(tree, chain, choice, where)
    limits, mended = zip(*(_limits(tree, tree.joints[n]) for n in chain), strict=True)
    _check_bodies(tree, chain)
    for name, value in locked.items():
        _lock(tree.joints[name], value, tree)
    stale = False
    for joint in tree.joints.values():  # movable joints with an empty range
        limit, kind = joint.find("limit"), joint.get("type")
        short = limit is not None and not {"velocity", "effort"} <= set(limit.attrib)
        follows = joint.find("mimic") is not None
        if kind in ("floating", "planar") or (kind not in MOVING and (short or follows)):
            _fix(joint)
            stale = True
    _refuse(tree.faults, where)
    flange, written = _flange(root, tree, chain, locked, choice.tip)
    table = np.array(limits, dtype=float).T
    table.setflags(write=False)
    lost = any(note.startswith("left out") for note in tree.notes)
    if any(mended) or locked or stale or lost or written:
        text = ET.tostring(root, encoding="unicode")
    if locked:
        tree.notes.insert(0, _locked_line(tree, chain, locked))
    notes = tuple(tree.notes)
    name = root.get("name", "")
    return UrdfArm(name, text, table, tuple(chain), locked, notes, flange)


def _parse(text: str, where: str) -> ET.Element:
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise RobotError(
            f"{where} does not parse as a URDF: {error}. Give a well-formed URDF file."
        ) from error
    if root.tag != "robot":
        raise RobotError(f"{where} is not a URDF: its root is <{root.tag}>, expected <robot>.")
    if any("xacro" in element.tag for element in root.iter()):
        raise RobotError(f"{where} is a xacro. Name it .xacro, and it is expanded as it is read.")
    if root.find("link") is None:
        raise RobotError(f"{where} has no link, expected a URDF with links and joints.")
    return root


def _refuse(faults: Sequence[str], where: str) -> None:
    """Raise one error with all faults of a file."""
    if faults:
        once = list(dict.fromkeys(faults))
        more = f"; and {len(once) - _FAULTS} more" if len(once) > _FAULTS else ""
        raise RobotError(f"{where}: {'; '.join(once[:_FAULTS])}{more}.")


# Which joints are the arm.


def _chain(tree: _Tree, choice: ArmChoice, where: str) -> list[str]:
    """Names of the joints of the arm, base to tip."""
    free = [
        name
        for name, joint in tree.joints.items()
        if joint.get("type") in MOVING and name not in (tree.mimics.keys() | choice.locked)
    ]
    if not free:
        raise RobotError(
            f"{where} has no revolute, continuous or prismatic joint that is free, expected an arm."
        )
    if choice.joints:
        chain = _named(tree, choice, where)
    elif choice.tip is not None:
        check_name(choice.tip, tree.links, f"link of {where}")
        chain = [name for name in tree.path(choice.tip) if name in free]
        if not chain:
            raise RobotError(
                f"{where}: no joint moves link '{choice.tip}'. Give --tip another link."
            )
    else:
        chain = _only(tree, free, choice.logged, where)
    for name, joint in tree.mimics.items():
        leader = joint.find("mimic").get("joint")
        for _ in tree.mimics:  # one may follow another that follows
            if leader in tree.mimics:
                leader = tree.mimics[leader].find("mimic").get("joint")
        if leader in chain:
            raise RobotError(
                f"{where}: joint '{name}' follows '{leader}', which is in the chain: "
                "such arms are not modelled. Take the leader out with --chain, or "
                "remove the <mimic> of a joint that is driven by itself."
            )
    return chain


def _named(tree: _Tree, choice: ArmChoice, where: str) -> list[str]:
    for name in choice.joints:
        check_name(name, tree.joints, f"joint of the chain in {where}")
    named = set(choice.joints)
    last = max(named, key=lambda name: len(tree.path(read_joint_link(tree.joints[name], "child"))))
    path = tree.path(read_joint_link(tree.joints[last], "child"))
    for name in choice.joints:
        if tree.joints[name].get("type") == "fixed":
            tree.faults.append(f"joint '{name}' of the chain is fixed")
        elif name in tree.mimics or tree.joints[name].get("type") not in MOVING:
            tree.faults.append(f"joint '{name}' of the chain cannot move by itself")
        elif name not in path:
            tree.faults.append(f"joints '{name}' and '{last}' are on no one chain")
        elif name in choice.locked:
            tree.faults.append(f"joint '{name}' is both in the chain and locked")
    _refuse(tree.faults, where)
    return [name for name in path if name in named]


def _only(tree: _Tree, free: Sequence[str], logged: Sequence[str], where: str) -> list[str]:
    """The only chain, of those named in the log, without hands."""
    # Chains that end within another one are dropped.
    ends = [*(tree.joints[name] for name in free), *tree.mimics.values()]
    chains = _apart([_without_hand(tree, free, j) for j in ends])
    in_logs = set(logged)
    if any(in_logs & set(chain) for chain in chains):
        spans = []  # from the first joint of each chain that is logged to the last
        for chain in chains:
            at = [i for i, name in enumerate(chain) if name in in_logs]
            spans.append(chain[at[0] : at[-1] + 1] if at else [])
        chains = _apart(spans)
        chains.sort(key=len, reverse=True)
        # Next to an arm of six or seven joints, a head of two is no arm.
        sizes = [len(set(other) - set(chains[0])) for other in chains[1:]]
        if all(2 * n <= len(chains[0]) for n in sizes):
            chains = chains[:1]
    if len(chains) == 1:
        return chains[0]
    listed = "; ".join(
        f"--tip {read_joint_link(tree.joints[chain[-1]], 'child')}: {len(chain)} "
        f"joints, {chain[0]} to {chain[-1]}"
        for chain in sorted(chains, key=len, reverse=True)[:_NAMED]
    )
    raise RobotError(
        f"{where} branches: it has {len(chains)} chains, and no names of joints in "
        f"the logs say which. Choose one with --chain a,b,c or --tip: {listed}."
    )


def _apart(chains: Sequence[list[str]]) -> list[list[str]]:
    """The chains that are not part of another one, each once."""
    once = [list(c) for c in dict.fromkeys(tuple(c) for c in chains) if c]
    return [c for c in once if not any(set(c) < set(other) for other in once)]


def _without_hand(tree: _Tree, free: Sequence[str], last: ET.Element) -> list[str]:
    """The joints leading to a given one, up to the fingers.

    Fingers are joints on a common link, or leading other joints, each with fewer joints
    than before them.
    """
    names = tree.path(read_joint_link(last, "child"))
    leaders = {joint.find("mimic").get("joint") for joint in tree.mimics.values()}
    trunk: list[str] = []
    for name in names:
        link = read_joint_link(tree.joints[name], "parent")
        while link in tree.above and tree.above[link].get("type") not in MOVING:
            link = read_joint_link(tree.above[link], "parent")
        beside = tree.moved_by(tree.below[link])
        deepest = max(_depth(tree, joint) for joint in beside)
        fingers = len(beside) > 1 or name in leaders or name in tree.mimics
        if fingers and max(TRUNK, deepest + 1) <= len(trunk):
            break
        if name in free:
            trunk.append(name)
    return trunk


def _depth(tree: _Tree, joint: ET.Element) -> int:
    below = tree.moved_by(tree.below.get(read_joint_link(joint, "child"), []))
    return 1 + max((_depth(tree, each) for each in below), default=0)


# Positions of all other joints.


def _locked(tree: _Tree, chain: Sequence[str], choice: ArmChoice, where: str) -> dict[str, float]:
    """Positions of the joints outside of the chain [rad or m], mimic joints included."""
    for name in choice.locked:
        check_name(name, tree.joints, f"joint in [locked] of {where}")

    def value(name: str, visited: tuple[str, ...] = ()) -> float:
        joint, mimic = tree.joints[name], tree.joints[name].find("mimic")
        if name in choice.locked:
            return float(choice.locked[name])
        leader = None if mimic is None else mimic.get("joint")
        if leader in tree.joints and leader not in (*visited, name):
            place = f"mimic of joint '{name}'"
            factor = tree.number(mimic, "multiplier", place)
            factor = factor if "multiplier" in mimic.attrib else 1.0
            offset = tree.number(mimic, "offset", place)
            return factor * value(leader, (*visited, name)) + offset
        node, place = joint.find("limit"), f"limit of joint '{name}'"
        low, high = (tree.number(node, k, place) for k in ("lower", "upper"))
        outside = joint.get("type") != "continuous" and (low > 0 or high < 0)
        return (low + high) / 2 if outside and -np.inf < low < high < np.inf else 0.0

    moving = [n for n, j in tree.joints.items() if j.get("type") in MOVING]
    return {name: value(name) for name in moving if name not in chain}


def _lock(joint: ET.Element, value: float, tree: _Tree) -> None:
    """Write a joint as a fixed one at a position [rad or m]."""
    if value:
        label, node = f"joint '{joint.get('name')}'", joint.find("origin")
        axis = tree.vector(joint.find("axis"), "xyz", "1 0 0", label)
        turned = tree.vector(node, "rpy", "0 0 0", label)
        at = tree.vector(node, "xyz", "0 0 0", label)
        place = pin.SE3(pin.rpy.rpyToMatrix(turned), at)
        axis = axis / max(np.linalg.norm(axis), 1e-12)
        if joint.get("type") == "prismatic":
            pose = place * pin.SE3(np.eye(3), value * axis)
        else:
            pose = place * pin.SE3(pin.exp3(value * axis), np.zeros(3))
        node = ET.SubElement(joint, "origin") if node is None else node
        node.attrib.update(write_origin(pose))
    _fix(joint)


def _fix(joint: ET.Element) -> None:
    joint.set("type", "fixed")
    for tag in ("mimic", "limit", "axis", "dynamics", "safety_controller"):
        for node in joint.findall(tag):
            joint.remove(node)


def _flange(
    root: ET.Element,
    tree: _Tree,
    chain: Sequence[str],
    locked: Mapping[str, float],
    tip: str | None,
) -> tuple[str, bool]:
    """The link of the flange, and whether it was written into the file.

    It is the tip, else the last link before locked joints. Our element stores it, since
    locked joints become fixed ones.
    """
    end = read_joint_link(tree.joints[chain[-1]], "child")
    node = root.find("modelgap")
    noted = "" if node is None else node.get("flange", "")
    links = tree.carried(end)
    chosen = [name for name in (tip, noted) if name in links]
    flange = chosen[0] if chosen else tree.last_link(end, locked)
    if flange == tree.last_link(end) and (node is None or not chosen):
        return "", False
    if flange != noted:
        node = ET.SubElement(root, "modelgap") if node is None else node
        node.set("flange", flange)
    return flange, flange != noted


def _locked_line(tree: _Tree, chain: Sequence[str], locked: Mapping[str, float]) -> str:
    """One line on a locked joint: name, position, and the links that it carries."""
    holders: dict[str, list[str]] = {}
    for name in locked:
        parent = read_joint_link(tree.joints[name], "parent")
        path = [n for n in tree.path(parent) if n in chain]
        # Locked joints are fixed now and not part of a path.
        holders.setdefault(path[-1] if path else "", []).append(name)
    parts = []
    for holder, names in holders.items():
        carried = [read_joint_link(tree.joints[name], "child") for name in names]
        links = set().union(*(tree.carried(link, chain) for link in carried))
        masses = [tree.links[link].find("inertial/mass") for link in links]
        mass = sum(float(node.get("value", "0")) for node in masses if node is not None)
        where = f"joint {chain.index(holder) + 1} ({holder})" if holder else "the base"
        at = abbreviate_list([f"{n} = {locked[n]:.4g}" for n in names])
        parts.append(f"{at} ({mass:.3g} kg on {where})")
    arm = f"chain of {len(chain)} joints {chain[0]} to {chain[-1]}"
    return f"{arm}; locked: {', '.join(parts)}"


def abbreviate_list(names: Sequence[str]) -> str:
    """The first names of a list, and the number of others."""
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


# Bodies and limits of the arm.


def _check_bodies(tree: _Tree, chain: Sequence[str]) -> None:
    """Check that the arm has a mass; note its links without one."""
    mass: dict[str, float] = {}
    hollow, light = [], []
    for name, link in tree.links.items():
        quantity = f"mass of link '{name}'"
        mass[name] = tree.number(link.find("inertial/mass"), "value", quantity)
        if not np.isfinite(mass[name]):
            tree.faults.append(f"{quantity} is infinite, expected a finite number")
        elif mass[name] < 0:
            tree.faults.append(f"link '{name}' has mass {mass[name]:g}, expected >= 0")
        tensor = link.find("inertial/inertia")
        keys = ("ixx", "iyy", "izz")
        if tensor is not None and mass[name] > 0:
            quantity = f"inertia of link '{name}'"
            if not any(tree.number(tensor, key, quantity) for key in keys):
                hollow.append(name)
    for name in chain:
        parts = tree.carried(read_joint_link(tree.joints[name], "child"), chain)
        if not sum(mass[part] for part in parts) > 0:
            light.append(name)
    if tree.faults:
        return
    if len(light) == len(chain):
        tree.faults.append(
            f"no link that joint '{chain[0]}' moves has a mass: give each an <inertial>"
        )
    elif light:
        tree.notes.append(f"no mass between these joints and the next: {abbreviate_list(light)}")
    if hollow:
        tree.notes.append(f"inertia tensor of zero: {abbreviate_list(hollow)}")


def _limits(tree: _Tree, joint: ET.Element) -> tuple[list[float], bool]:
    """Return lower, upper, velocity and effort, and whether they were rewritten.

    A limit of 0 means not given. A continuous joint has two positions (cos, sin) for one
    velocity in Pinocchio; a revolute one with a very large range keeps q and qd of the
    same size.
    """
    node, name = joint.find("limit"), joint.get("name")
    axis = joint.find("axis")
    if axis is not None and not any(c in "123456789" for c in axis.get("xyz", "1")):
        tree.faults.append(f"joint '{name}' has an axis of length zero")
    quantity, turns = f"limit of joint '{name}'", joint.get("type") == "continuous"
    rates = {k: tree.number(node, k, quantity) for k in ("effort", "velocity")}
    ends = {k: tree.number(node, k, quantity) for k in ("lower", "upper")}
    lower, upper = ends.values()
    endless = upper == -lower == float(ENDLESS)
    if not (turns or lower < upper):
        tree.notes.append(f"joint '{name}' has no range: not checked")
    if turns or endless or not lower < upper:
        lower, upper = -np.inf, np.inf
    there = set() if node is None else set(node.attrib)
    mended = {k: "0" for k, x in rates.items() if k not in there or np.isinf(x)}
    if turns or not endless:
        mended |= {"lower": f"-{ENDLESS}"} if np.isinf(lower) else {}
        mended |= {"upper": ENDLESS} if np.isinf(upper) else {}
    if mended:
        joint.set("type", "revolute" if turns else joint.get("type", ""))
        node = ET.SubElement(joint, "limit") if node is None else node
        node.attrib.update(mended)
    effort, speed = (abs(x) or np.inf for x in rates.values())
    return [lower, upper, speed, effort], bool(mended)


def write_origin(place: pin.SE3) -> dict[str, str]:
    """Attributes of an <origin>."""
    turned = pin.rpy.matrixToRpy(place.rotation)
    return {"xyz": format_numbers(place.translation), "rpy": format_numbers(turned)}


def format_numbers(values: Iterable) -> str:
    """Numbers with all digits of a double, in the format of URDF and MJCF."""
    return " ".join(repr(float(value)) for value in values)


def read_joint_link(joint: ET.Element, side: str) -> str:
    """Name of the parent or child link of a joint, "" if missing."""
    node = joint.find(side)
    return "" if node is None else node.get("link", "")
