"""Faults that no line of a map repairs: of sensors, clocks, motions and robot files."""

import xml.etree.ElementTree as ET

import numpy as np

from benchmarks.check_parts.arms import (
    DURATION,
    RATE,
    FaultyLogs,
    Host,
    other_arms,
    recorded,
    some,
    table_of,
    tables_of,
)
from sim.engine.plant_records import ReferenceMotion
from sim.plant.typical_sizes import compute_usual_motion_range
from tests.synthetic.motions import make_motion

Array = np.ndarray
Rng = np.random.Generator


def clock(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """Five times repeat, the clock starts again, or leaps three seconds ahead."""
    tables = tables_of(host)
    t = tables[0]["t"].copy()
    at = int(rng.integers(len(t) // 4, len(t) // 2))
    if size == 0:
        t[at : at + 5] = t[at]
    elif size == 1:
        t[at:] -= t[at] - t[0]
    else:
        t[at:] += 3.0
    return FaultyLogs("clock", (), [tables[0] | {"t": t}, *tables[1:]])


def spike(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """One sample of a torque is 30 times too large, of an angle 1 rad off, or 1e308."""
    name = ("tau", "q", "tau")[size]

    def spoil(x: Array, at: int) -> None:
        x[at] = (30 * np.abs(x).max(), x[at] + 1.0, 1e308)[size]

    return _of_one(host, rng, "spike", name, spoil)


def frozen(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """A torque, an angle, or a torque from there on, stands while the arm moves."""
    name, share = (("tau", 0.3), ("q", 0.2), ("tau", 0.6))[size]

    def spoil(x: Array, at: int) -> None:
        x[at : at + int(share * len(x))] = x[at]

    return _of_one(host, rng, "frozen", name, spoil)


def quantised(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """A torque comes in steps of a quarter, a half, or one of its deviation."""
    share = (0.25, 0.5, 1.0)[size]

    def spoil(x: Array, at: int) -> None:
        step = share * x.std()
        x[:] = np.round(x / step) * step

    return _of_one(host, rng, "quantised", "tau", spoil, in_all_logs=True)


def saturated(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """A torque ends at 60, 40 or 25 % of its largest value."""
    share = (0.6, 0.4, 0.25)[size]

    def spoil(x: Array, at: int) -> None:
        level = share * np.abs(x).max()
        np.clip(x, -level, level, out=x)

    return _of_one(host, rng, "saturated", "tau", spoil, in_all_logs=True)


def out_of_range(host: Host, size: int, rng: Rng) -> FaultyLogs | None:
    """An angle lies 0.3, 0.8 or 2 rad beyond the end of its range."""
    free = [j for j in range(host.robot.dof) if np.isfinite(host.robot.upper[j])]
    if not free:
        return None
    joint, beyond = int(rng.choice(free)), (0.3, 0.8, 2.0)[size]
    tables = tables_of(host)
    highest = max(table["q"][:, joint].max() for table in tables)
    off = np.zeros(host.robot.dof)
    off[joint] = host.robot.upper[joint] + beyond - highest
    moved = [table | {"q": table["q"] + off} for table in tables]
    return FaultyLogs("out_of_range", (joint + 1,), moved)


def _of_one(host: Host, rng: Rng, kind: str, name: str, spoil, in_all_logs=False) -> FaultyLogs:
    """Spoil a signal of one joint: in one log, or in all where the sensor does it."""
    (joint,), tables = some(rng, host.robot.dof, 1), tables_of(host)
    at = int(rng.integers(len(tables[0]["t"]) // 5, len(tables[0]["t"]) // 3))
    out = []
    for i, table in enumerate(tables):
        signal = table[name].copy()
        if in_all_logs or i == 0:
            spoil(signal[:, joint - 1], at)
        out.append(table | {name: signal})
    return FaultyLogs(kind, (joint,), out)


def lockstep(host: Host, size: int, rng: Rng) -> FaultyLogs | None:
    """Two, half, or all joints move in proportion, in every log."""
    if host.plant is None:
        return None
    dof = host.robot.dof
    joints = some(rng, dof, (2, dof // 2, dof)[size])
    space = compute_usual_motion_range(host.robot)

    def couple(motion: ReferenceMotion) -> ReferenceMotion:
        q, qd, qdd = motion.q.copy(), motion.qd.copy(), motion.qdd.copy()
        lead = joints[0] - 1
        for j in (joint - 1 for joint in joints[1:]):
            ratio = space.amplitude[j] / space.amplitude[lead]
            ratio = min(ratio, space.velocity[j] / space.velocity[lead])
            q[:, j] = space.centre[j] + ratio * (q[:, lead] - space.centre[lead])
            qd[:, j], qdd[:, j] = ratio * qd[:, lead], ratio * qdd[:, lead]
        return ReferenceMotion(motion.kind, motion.t, q, qd, qdd, None)

    return _in_motion(host, rng, "lockstep", joints, couple)


def no_reversal(host: Host, size: int, rng: Rng) -> FaultyLogs | None:
    """One, half, or all joints go one way only, at a speed that varies."""
    if host.plant is None:
        return None
    dof = host.robot.dof
    joints = some(rng, dof, (1, dof // 2, dof)[size])
    space, rate = compute_usual_motion_range(host.robot), 2 * np.pi / 3.0

    def one_way(motion: ReferenceMotion) -> ReferenceMotion:
        q, qd, qdd, t = motion.q.copy(), motion.qd.copy(), motion.qdd.copy(), motion.t
        for j in (joint - 1 for joint in joints):
            speed = 2 * space.amplitude[j] / t[-1]
            swing = 0.8 * speed / rate
            low = space.centre[j] - space.amplitude[j]
            q[:, j] = low + speed * t + swing * np.sin(rate * t)
            qd[:, j] = speed + swing * rate * np.cos(rate * t)
            qdd[:, j] = -swing * rate**2 * np.sin(rate * t)
        return ReferenceMotion(motion.kind, t, q, qd, qdd, None)

    return _in_motion(host, rng, "no_reversal", joints, one_way)


def _in_motion(host: Host, rng: Rng, kind: str, joints, change) -> FaultyLogs:
    logs = []
    for i in range(2):
        motion = make_motion("fourier", host.robot, DURATION, RATE, rng)
        label = f"{kind}_{i}"
        logs.append(recorded(host.plant, change(motion), label, 30.0 * i))
    return FaultyLogs(kind, joints, [table_of(log) for log in logs])


def too_short(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """There is one log of 1.5, 2.5 or 4 s."""
    table = tables_of(host)[0]
    middle = table["t"][len(table["t"]) // 4]
    rows = (table["t"] >= middle) & (table["t"] < middle + (1.5, 2.5, 4.0)[size])
    return FaultyLogs("too_short", (), [{k: x[rows] for k, x in table.items()}])


def robot_file(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """Masses in grams, lengths in millimetres, or gravity in mm/s^2."""
    tables, toml = tables_of(host), ""
    root = ET.fromstring(host.robot.urdf)
    for tag in (("mass", "inertia"), ("origin",), ())[size]:
        for element in root.iter(tag):
            for key in {"xyz"} if tag == "origin" else set(element.attrib):
                values = (1e3 * float(x) for x in element.get(key, "0 0 0").split())
                element.set(key, " ".join(map(repr, values)))
    if size == 2:
        toml = "[robot]\ngravity = [0, 0, -9810.0]\n"
    urdf = ET.tostring(root, encoding="unicode")
    right = tables if size == 2 else ()
    return FaultyLogs("robot_file", (), tables, right, urdf=urdf, toml=toml)


def wrong_robot(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """The robot that is given is an arm of another build."""
    urdf = other_arms(host.robot.dof)[size].urdf
    return FaultyLogs("wrong_robot", (), tables_of(host), urdf=urdf)
