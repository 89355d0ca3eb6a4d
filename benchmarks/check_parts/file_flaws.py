"""Robot files with bodies that no link has, or with masses of another scale."""

import xml.etree.ElementTree as ET

import numpy as np

from benchmarks.check_parts.arms import Host
from residual.errors import RobotError
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.files import build_pinocchio_model
from residual.robot.robot import Robot, build_robot

Rng = np.random.Generator
FLAWED, SCALED = "flawed bodies", "scaled masses"
WAYS = ("ball", "shared", "sum", "negative", "unit")
MOVED = 0.05  # of the torque's rms: what a flaw moves at least
PART = 0.01  # the same of one link that is to be named
_MOMENTS = ("ixx", "iyy", "izz")
_PRODUCTS = ("ixy", "ixz", "iyz")


def draw_flawed(arm: Host, rng: Rng) -> tuple[Robot, list[str]]:
    """Draw one to three placeholders or impossible tensors that move the torque.

    Returns:
        The robot as a file with these has it, and the links whose flaw moves it.
    """
    while True:
        root = ET.fromstring(arm.robot.urdf)
        links = _moving(arm.robot, root)
        names = [str(n) for n in rng.permutation(list(links))[: rng.integers(1, 4)]]
        way = str(rng.choice(WAYS))
        if way == "shared" and len(names) < 2:
            continue
        for name in names:
            _spoil(way, links[name], links[names[0]], rng)
        text = ET.tostring(root, encoding="unicode")
        try:
            moved = _moved(arm, text)
        except RobotError:  # of a tensor that the parser itself refuses
            continue
        if moved < MOVED:
            continue
        told = [n for n in names if _moved(arm, _only(arm.robot, text, n)) > PART]
        return build_robot(arm.robot.name, text, arm.robot.toml), told


def draw_scaled(arm: Host, rng: Rng) -> tuple[Robot, float]:
    """Draw a file whose masses and tensors are all 0.24 to 4 times those of the arm."""
    factor = float(np.exp(rng.uniform(np.log(0.24), np.log(4.0))))
    return scale_masses(arm.robot, factor), factor


def scale_masses(robot: Robot, factor: float) -> Robot:
    """Return an arm as a file has it whose masses are all so many times too large."""
    root = ET.fromstring(robot.urdf)
    for element in (*root.iter("mass"), *root.iter("inertia")):
        for key, value in element.attrib.items():
            element.set(key, repr(factor * float(value)))
    text = ET.tostring(root, encoding="unicode")
    return build_robot(robot.name, text, robot.toml)


def _moving(robot: Robot, root: ET.Element) -> dict[str, ET.Element]:
    """The tensors of the links that the joints of the arm move."""
    children = {
        j.find("child").get("link") for j in root.findall("joint") if j.get("name") in robot.joints
    }
    links = {n.get("name"): n.find("inertial/inertia") for n in root.findall("link")}
    return {k: t for k, t in links.items() if k in children and t is not None}


def _spoil(way: str, tensor: ET.Element, first: ET.Element, rng: Rng) -> None:
    size = {k: float(tensor.get(k, "0")) for k in (*_MOMENTS, *_PRODUCTS)}
    axis = str(rng.choice(_MOMENTS))
    if way == "ball":
        ball = float(rng.choice([1.0, 0.5, 0.1, 0.05, 0.01, 1e-3, 1e-6]))
        size = dict.fromkeys(_MOMENTS, ball) | dict.fromkeys(_PRODUCTS, 0.0)
    elif way == "shared":
        size = {k: float(first.get(k, "0")) for k in size}
    elif way == "sum":
        size[axis] = float(rng.uniform(1.5, 10)) * sum(size[k] for k in _MOMENTS)
    elif way == "negative":
        size[axis] *= -float(rng.uniform(0.5, 5))
    else:
        factor = float(rng.choice([1e3, 1e4, 1e6]))
        size = {k: factor * x for k, x in size.items()}
    for key, value in size.items():
        tensor.set(key, repr(value))


def _only(robot: Robot, text: str, name: str) -> str:
    """The arm's own file with the flawed tensor of one link."""
    root, flawed = ET.fromstring(robot.urdf), ET.fromstring(text)
    place = f"link[@name='{name}']/inertial/inertia"
    root.find(place).attrib.update(flawed.find(place).attrib)
    return ET.tostring(root, encoding="unicode")


def _moved(arm: Host, text: str) -> float:
    """Torque that the bodies of a text move, as a share of the arm's rms."""
    model = build_pinocchio_model(text, "a drawn file")
    model.gravity.linear = arm.robot.model.gravity.linear
    (log, *_) = arm.logs
    rows = slice(None, None, 10)
    qd = np.gradient(log.q, log.t, axis=0)
    qdd = np.gradient(_smooth(qd), log.t, axis=0)
    motion = log.q[rows], qd[rows], qdd[rows]
    own = compute_inverse_dynamics(arm.robot.model, *motion)
    other = compute_inverse_dynamics(model, *motion)
    return float(np.linalg.norm(other - own) / np.linalg.norm(own))


def _smooth(x: np.ndarray, width: int = 25) -> np.ndarray:
    kernel = np.ones(width) / width
    return np.stack([np.convolve(c, kernel, "same") for c in x.T], axis=1)
