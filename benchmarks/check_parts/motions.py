"""Faults of the motion, and of the robot that is given."""

import xml.etree.ElementTree as ET

import numpy as np

from benchmarks.check_parts.arms import DURATION, RATE, Host, others, recorded
from benchmarks.check_parts.spoiled import Spoiled, some, table_of, tables_of
from benchmarks.synthetic.motions import make_motion
from sim.records import Reference
from sim.sizes import room

Array = np.ndarray
Rng = np.random.Generator


def lockstep(host: Host, size: int, rng: Rng) -> Spoiled | None:
    """Two, half, or all joints move in proportion, in every log."""
    if host.plant is None:
        return None
    dof = host.robot.dof
    joints = some(rng, dof, (2, dof // 2, dof)[size])
    space = room(host.robot)

    def couple(motion: Reference) -> Reference:
        q, qd, qdd = motion.q.copy(), motion.qd.copy(), motion.qdd.copy()
        lead = joints[0] - 1
        for j in (joint - 1 for joint in joints[1:]):
            ratio = space.amplitude[j] / space.amplitude[lead]
            ratio = min(ratio, space.velocity[j] / space.velocity[lead])
            q[:, j] = space.centre[j] + ratio * (q[:, lead] - space.centre[lead])
            qd[:, j], qdd[:, j] = ratio * qd[:, lead], ratio * qdd[:, lead]
        return Reference(motion.kind, motion.t, q, qd, qdd, None)

    return _moved(host, rng, "lockstep", joints, couple)


def no_reversal(host: Host, size: int, rng: Rng) -> Spoiled | None:
    """One, half, or all joints go one way only, at a speed that varies."""
    if host.plant is None:
        return None
    dof = host.robot.dof
    joints = some(rng, dof, (1, dof // 2, dof)[size])
    space, rate = room(host.robot), 2 * np.pi / 3.0

    def one_way(motion: Reference) -> Reference:
        q, qd, qdd, t = motion.q.copy(), motion.qd.copy(), motion.qdd.copy(), motion.t
        for j in (joint - 1 for joint in joints):
            speed = 2 * space.amplitude[j] / t[-1]
            swing = 0.8 * speed / rate
            low = space.centre[j] - space.amplitude[j]
            q[:, j] = low + speed * t + swing * np.sin(rate * t)
            qd[:, j] = speed + swing * rate * np.cos(rate * t)
            qdd[:, j] = -swing * rate**2 * np.sin(rate * t)
        return Reference(motion.kind, t, q, qd, qdd, None)

    return _moved(host, rng, "no_reversal", joints, one_way)


def _moved(host: Host, rng: Rng, kind: str, joints, change) -> Spoiled:
    logs = []
    for i in range(2):
        motion = make_motion("fourier", room(host.robot), DURATION, RATE, rng)
        label = f"{kind}_{i}"
        logs.append(recorded(host.plant, change(motion), label, 30.0 * i))
    return Spoiled(kind, joints, [table_of(log) for log in logs])


def too_short(host: Host, size: int, rng: Rng) -> Spoiled:
    """There is one log of 1.5, 2.5 or 4 s."""
    table = tables_of(host)[0]
    middle = table["t"][len(table["t"]) // 4]
    rows = (table["t"] >= middle) & (table["t"] < middle + (1.5, 2.5, 4.0)[size])
    return Spoiled("too_short", (), [{k: x[rows] for k, x in table.items()}])


def robot_file(host: Host, size: int, rng: Rng) -> Spoiled:
    """Masses in grams, lengths in millimetres, or gravity in mm/s^2."""
    tables, toml = tables_of(host), ""
    root = ET.fromstring(host.robot.urdf)
    if size == 0:
        for element in root.iter("mass"):
            _times(element, ("value",), 1e3)
        for element in root.iter("inertia"):
            _times(element, tuple(element.attrib), 1e3)
    elif size == 1:
        for element in root.iter("origin"):
            _times(element, ("xyz",), 1e3)
    else:
        toml = "[robot]\ngravity = [0, 0, -9810.0]\n"
    urdf = ET.tostring(root, encoding="unicode")
    right = tables if size == 2 else ()
    return Spoiled("robot_file", (), tables, right, urdf=urdf, toml=toml)


def wrong_robot(host: Host, size: int, rng: Rng) -> Spoiled:
    """The robot that is given is an arm of another build."""
    urdf = others(host.robot.dof)[size].urdf
    return Spoiled("wrong_robot", (), tables_of(host), urdf=urdf)


def _times(element: ET.Element, keys: tuple[str, ...], factor: float) -> None:
    for key in keys:
        if key in element.attrib:
            values = (factor * float(x) for x in element.attrib[key].split())
            element.set(key, " ".join(map(repr, values)))
