"""Faults of reading (signs, order, units, gears, scales, speeds) and of reports.

Reports: currents, torque with a part gone, commands, dead angles. What a driver takes
out is the arm's own weight and friction, by the clean log, not what the robot file says
of them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.check_parts.arms import (
    DURATION,
    RATE,
    Host,
    Spoiled,
    Table,
    changed,
    recorded,
    some,
    tables_of,
    told_apart,
    turned,
)
from benchmarks.synthetic.motions import make_motion
from residual.check.motion import Motion, thin_rows
from residual.recording import Recording
from residual.robot.dynamics import gravity_torque, inverse_dynamics
from residual.signals.filters import low_pass
from sim.plant.sizes import usual_limits

Array = np.ndarray
Rng = np.random.Generator

_SMOOTH = 6.0  # Hz: what is left of an angle is a reference
_PLANNED = 20.0  # Hz
_LAG = 0.01  # s by which an arm follows its reference
_SHOWS = 0.25  # of the logged torque of some joint: a rough file misses as much
_KGF_CM = 10.1972
_NOISE = 5e-5  # rad


def motor_current(host: Host, size: int, rng: Rng) -> Spoiled:
    """Torque is divided by 8 to 15 per joint, by one such factor, or in kgf cm."""
    dof = host.robot.dof
    each = rng.uniform(8, 15, dof)
    factor = (1 / each, 1 / each[0], _KGF_CM)[size]
    tables = changed(tables_of(host), ("tau",), lambda x: x * factor)
    return Spoiled("torque_unit", (), tables)


def joints_swapped(host: Host, size: int, rng: Rng) -> Spoiled | None:
    """Exchange neighbours, any two joints, or two in two logs, where that shows."""
    dof, right = host.robot.dof, tables_of(host)
    for _ in range(40):
        a = int(rng.integers(1, dof))
        joints = some(rng, dof, 2) if size == 1 else (a, a + 1)
        order = np.arange(dof)
        order[[j - 1 for j in joints]] = [j - 1 for j in reversed(joints)]
        if told_apart(host, lambda q: q[:, order], lambda x: x[:, order], _SHOWS):  # noqa: B023
            break
    else:
        return None
    right = right[:2] if size == 2 else right
    tables = changed(right, _ALL, lambda x: x[:, order])
    return Spoiled("joint_order", joints, tables, right)


def gravity_removed(host: Host, size: int, rng: Rng) -> Spoiled:
    """Weight is taken out: as it is, or by a model that is 5 or 10 % off."""
    share = (1.0, 1.05, 0.9)[size] * _own(host)[0]
    model = host.robot.model

    def change(table: Table) -> Table:
        weight = gravity_torque(model, table["q"], model.gravity.linear)
        return table | {"tau": table["tau"] - share * weight}

    tables = [change(table) for table in tables_of(host)]
    return Spoiled("gravity_removed", (), tables)


def _own(host: Host) -> tuple[Array, Array, Array]:
    """Share of the nominal weight, dry and viscous friction of the arm. (dof,)."""
    motion = thin_rows(host.logs)
    robot = host.robot
    whole = inverse_dynamics(robot.model, motion.q, motion.qd, motion.qdd)
    weight = gravity_torque(robot.model, motion.q, robot.model.gravity.linear)
    rows = [_of_joint(motion, j, weight[:, j], whole[:, j]) for j in range(robot.dof)]
    return tuple(np.array(x) for x in zip(*rows, strict=True))


def _of_joint(motion: Motion, j: int, weight: Array, whole: Array) -> Array:
    use = motion.moving[:, j]
    if use.sum() < 30:
        return np.array([1.0, 0.0, 0.0])
    qd = motion.qd[use, j]
    x = np.column_stack(
        [
            weight[use],
            np.sign(qd),
            qd,
            (whole - weight)[use],
            motion.qdd[use, j],
            np.ones_like(qd),
        ]
    )
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-9
    x = x / size
    # What the log does not show is as the robot file says, and without friction.
    tau = motion.tau[use, j]
    ridge = 1e-3 * len(x) * np.eye(6)
    known = np.array([1.0, 0, 0, 1.0, 0, 0]) * size
    at = known + np.linalg.solve(x.T @ x + ridge, x.T @ (tau - x @ known))
    return (at / size)[:3]


def commanded(host: Host, size: int, rng: Rng) -> Spoiled:
    """Torque is the model's for the reference; with friction; or equal in a repeat."""
    _, dry, wet = _own(host)
    tables = []
    for log, table in zip(host.logs, tables_of(host), strict=True):
        rate, even, q = _planned(log)
        qd, qdd = (low_pass(q, 0.2 * rate, rate, order=k) for k in (1, 2))
        tau = inverse_dynamics(host.robot.model, q, qd, qdd)
        slow = 0.02 * np.sqrt(np.mean(qd**2, axis=0)) + 1e-9
        if size:
            tau = tau + dry * np.tanh(qd / slow) + wet * qd
        own = _referred(log, table)
        tables.append(own | {"tau": _at(table["t"], even, tau)})
    return Spoiled("commanded", (), _twice(tables[0], rng) if size == 2 else tables)


def _referred(log: Recording, table: Table) -> Table:
    """The log with a reference."""
    q = log.q_ref
    if q is None:
        _, even, planned = _planned(log)
        q = _at(log.t, even, planned)
    return table | {"q_ref": np.array(q)}


def _planned(log: Recording) -> tuple[float, Array, Array]:
    """The reference as its planner has it: its rate [Hz], times and angles, even.

    Where none is logged it is the angle, smooth and ahead. What is logged of one is
    rounded, what the driver computes with is not.
    """
    rate = 1 / float(np.median(np.diff(log.t)))
    even = np.arange(log.t[0], log.t[-1], 1 / rate)
    if log.q_ref is not None:
        return rate, even, low_pass(_at(even, log.t, log.q_ref), _PLANNED, rate)
    smooth = low_pass(_at(even, log.t, log.q), _SMOOTH, rate)
    return rate, even, _at(even + _LAG, even, smooth)


def _at(t: Array, times: Array, x: Array) -> Array:
    return np.column_stack([np.interp(t, times, column) for column in x.T])


def _twice(table: Table, rng: Rng) -> list[Table]:
    """One motion twice, each time with noise of its own; no reference is logged."""
    t, q = table["t"], table["q"]
    one = {k: v for k, v in table.items() if k != "q_ref"}
    noise = _NOISE * rng.normal(size=q.shape)
    return [one, one | {"t": t + t[-1] - t[0] + 10.0, "q": q + noise}]


def constant(host: Host, size: int, rng: Rng) -> Spoiled | None:
    """An angle keeps one value: in all logs, in one, or beside its reference."""
    dof, tables = host.robot.dof, tables_of(host)
    moves = np.min([np.ptp(table["q"], axis=0) for table in tables], axis=0)
    free = [j for j in range(dof) if moves[j] > 0.1]
    if not free:
        return None
    joint = int(rng.choice(free))
    if size == 2:
        pairs = zip(host.logs, tables, strict=True)
        tables = [_referred(log, table) for log, table in pairs]
    out = []
    for i, table in enumerate(tables):
        dead = {k: table[k].copy() for k in ("q", "qd") if k in table}
        if size != 1 or i == 0:
            for name, signal in dead.items():
                signal[:, joint] = 0.0 if name == "qd" else signal[0, joint]
        out.append(table | dead)
    return Spoiled("constant", (joint + 1,), out)


def held(host: Host, rng: Rng) -> Host | None:
    """Return the arm with sound logs in which a joint is held, its encoder silent."""
    if host.plant is None:
        return None
    logs = []
    for i, family in enumerate(("fourier", "cyclic")):
        motion = make_motion(family, usual_limits(host.robot), DURATION, RATE, rng)
        joint = int(rng.integers(host.robot.dof))
        q, qd, qdd = motion.q.copy(), motion.qd.copy(), motion.qdd.copy()
        q[:, joint], qd[:, joint], qdd[:, joint] = q[0, joint], 0.0, 0.0
        still = replace(motion, q=q, qd=qd, qdd=qdd)
        log = recorded(host.plant, still, f"held_{i}", 30.0 * i)
        angles = np.array(log.q)
        angles[:, joint] = angles[0, joint]
        logs.append(replace(log, q=angles))
    return Host(host.name, host.robot, tuple(logs), host.plant)


_TRIES = 40
_ALL = ("q", "qd", "tau")


def torque_sign(host: Host, size: int, rng: Rng) -> Spoiled:
    """Torque of one, two or all joints counts the other way round."""
    joints, also = _turnable(host, size, rng, "angle_sign")
    sign, right = turned(host.robot.dof, joints), tables_of(host)
    tables = changed(right, ("tau",), lambda x: x * sign)
    return Spoiled("torque_sign", joints, tables, right, also=also)


def angle_sign(host: Host, size: int, rng: Rng) -> Spoiled:
    """Angles (and speeds) of one, two or all joints count the other way round."""
    joints, also = _turnable(host, size, rng, "torque_sign")
    sign, right = turned(host.robot.dof, joints), tables_of(host)
    tables = changed(right, ("q", "qd"), lambda x: x * sign)
    return Spoiled("angle_sign", joints, tables, right, also=also)


def _turnable(
    host: Host, size: int, rng: Rng, other: str
) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Draw joints whose turned angles are not the same as their turned torques.

    Where there are none, since the arm is its own mirror image, the other kind is as
    right an answer.
    """
    dof = host.robot.dof
    for _ in range(_TRIES):
        joints = some(rng, dof, (1, 2, dof)[size])
        sign = turned(dof, joints)
        if told_apart(host, lambda q: q * sign, lambda tau: tau * sign):  # noqa: B023
            return joints, ()
    return joints, (other,)


def joint_order(host: Host, size: int, rng: Rng) -> Spoiled | None:
    """Two torques, two joints (as in 3 to 5, too), or three in a ring are exchanged."""
    if size > 2:
        return joints_swapped(host, size - 3, rng)
    dof, right = host.robot.dof, tables_of(host)
    for _ in range(_TRIES):
        joints = some(rng, dof, (2, 2, 3)[size])
        order = np.arange(dof)
        order[[j - 1 for j in joints]] = np.roll([j - 1 for j in joints], 1)
        names = _ALL if size == 1 else ("tau",)
        if size != 1 or told_apart(host, lambda q: q[:, order], lambda x: x[:, order]):  # noqa: B023
            break
    else:
        return None
    tables = changed(right, names, lambda x: x[:, order])
    return Spoiled("joint_order", joints, tables, right)


def torque_unit(host: Host, size: int, rng: Rng) -> Spoiled:
    """Torque in N mm, kN m or N cm; sizes 3 to 5 are currents, or in other units."""
    if size > 2:
        return motor_current(host, size - 3, rng)
    return _scaled(host, "torque_unit", {"tau": (1e3, 1e-3, 1e2)[size]})


def angle_unit(host: Host, size: int, rng: Rng) -> Spoiled:
    """Degrees: of angles and speeds, of angles alone, or of some joints only."""
    right, degrees, dof = tables_of(host), 180 / np.pi, host.robot.dof
    if size < 2:
        names = ("q", "qd") if size == 0 else ("q",)
        return _scaled(host, "angle_unit", dict.fromkeys(names, degrees))
    joints = some(rng, dof, 2)
    factor = np.where(turned(dof, joints) < 0, degrees, 1.0)
    tables = changed(right, ("q", "qd"), lambda x: x * factor)
    return Spoiled("angle_unit", joints, tables, right)


def time_unit(host: Host, size: int, rng: Rng) -> Spoiled:
    """Milliseconds, microseconds; a clock at half speed where speeds are logged."""
    known = "qd" in tables_of(host)[0]
    return _scaled(host, "time_unit", {"t": (1e3, 1e6, 2.0 if known else 1e-3)[size]})


def gear_ratio(host: Host, size: int, rng: Rng) -> Spoiled:
    """Torques, angles, or both are of the motor; the robot file has the gears."""
    gears = np.round(rng.uniform(50, 160, host.robot.dof), 1)
    factors = ({"tau": 1 / gears}, {"q": gears, "qd": gears})
    factors = (*factors, factors[0] | factors[1])[size]
    toml = f"[joints]\ngear_ratio = {gears.tolist()}\n"
    spoiled = _scaled(host, "gear_ratio", factors)
    return Spoiled("gear_ratio", (), spoiled.tables, spoiled.right, toml=toml)


def velocity_mismatch(host: Host, size: int, rng: Rng) -> Spoiled | None:
    """Speed of a joint is negated, speeds are in deg/s, two are exchanged."""
    right, dof = tables_of(host), host.robot.dof
    if "qd" not in right[0]:
        return None
    joints: Sequence[int] = some(rng, dof, (1, dof, 2)[size])
    order = np.arange(dof)
    factor = turned(dof, joints) if size == 0 else np.ones(dof)
    if size == 1:
        factor = factor * 180 / np.pi
    if size == 2:
        order[[j - 1 for j in joints]] = [j - 1 for j in reversed(joints)]
    tables = changed(right, ("qd",), lambda x: x[:, order] * factor)
    also = ("angle_unit",) if size == 1 else ()
    where = () if size == 1 else tuple(joints)
    return Spoiled("velocity_mismatch", where, tables, right, also=also)


def _scaled(host: Host, kind: str, factors: dict) -> Spoiled:
    right = tables = tables_of(host)
    for name, factor in factors.items():
        tables = changed(tables, (name,), lambda x: x * factor)  # noqa: B023
    return Spoiled(kind, (), tables, right)
