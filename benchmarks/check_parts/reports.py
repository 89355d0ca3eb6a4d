"""Faults of the map (signs, order, units, gears, speeds) and of what is logged."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.check_parts.arms import (
    DURATION,
    RATE,
    FaultyLogs,
    Host,
    Table,
    changed,
    differ,
    recorded,
    some,
    table_of,
    tables_of,
    turned,
)
from residual.recording import Recording
from residual.robot.dynamics import compute_gravity_torque, compute_inverse_dynamics
from residual.signals.filters import filter_low_pass
from sim.plant.typical_sizes import estimate_typical_sizes
from tests.synthetic.motions import make_motion

Array = np.ndarray
Rng = np.random.Generator

_SMOOTH = 6.0  # Hz: what is left of an angle is a reference
_PLANNED = 20.0  # Hz
_LAG = 0.01  # s by which an arm follows its reference
_SHOWS = 0.25  # of the logged torque of some joint: a rough file misses as much
_KGF_CM = 10.1972


def gravity_removed(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """The driver subtracts the weight: by the robot file, or 5 or 10 % off."""
    return without_weight(host, (1.0, 1.05, 0.9)[size])


def without_weight(host: Host, share: float | Array) -> FaultyLogs:
    """Return logs without a share of the weight that each joint carries."""
    tables = tables_of(host)
    light = [t | {"tau": t["tau"] - share * weight_of(host, t["q"])} for t in tables]
    return FaultyLogs("gravity_removed", (), light)


def weight_of(host: Host, q: Array) -> Array:
    """Return the torque of the weight at some angles. Shapes (n, dof)."""
    model = host.robot.model
    return compute_gravity_torque(model, q, model.gravity.linear)


def mounting(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """The robot file has another direction of gravity, 20, 90 or 180 degrees off."""
    angle, around = np.deg2rad((20, 90, 180)[size]), rng.uniform(0, 2 * np.pi)
    level = np.sin(angle) * np.array([np.cos(around), np.sin(around)])
    gravity = (9.81 * np.array([*level, -np.cos(angle)])).tolist()
    tables, toml = tables_of(host), f"[robot]\ngravity = {gravity}\n"
    return FaultyLogs("mounting", (), tables, tables, toml=toml)


def commanded(host: Host, size: int, rng: Rng) -> FaultyLogs | None:
    """Torque is the model's for the reference, without or with friction."""
    if size == 2:
        return None
    tables, friction = [], estimate_typical_sizes(host.robot)
    for log in host.logs:
        rate, even, q = _planned(log)
        qd, qdd = (filter_low_pass(q, 0.2 * rate, rate, order=k) for k in (1, 2))
        tau = compute_inverse_dynamics(host.robot.model, q, qd, qdd)
        if size:
            slow = 0.02 * np.sqrt(np.mean(qd**2, axis=0)) + 1e-9
            tau = tau + friction.coulomb * np.tanh(qd / slow) + friction.viscous * qd
        tables.append(_referred(log) | {"tau": _at(log.t, even, tau)})
    return FaultyLogs("commanded", (), tables)


def _referred(log: Recording) -> Table:
    q = log.q_ref
    if q is None:
        _, even, planned = _planned(log)
        q = _at(log.t, even, planned)
    return table_of(log) | {"q_ref": np.array(q)}


def _planned(log: Recording) -> tuple[float, Array, Array]:
    """Return rate [Hz], even times and the reference as the planner has it.

    Without a logged reference it is the angle, smooth and ahead.
    """
    rate = 1 / float(np.median(np.diff(log.t)))
    even = np.arange(log.t[0], log.t[-1], 1 / rate)
    if log.q_ref is not None:
        return rate, even, filter_low_pass(_at(even, log.t, log.q_ref), _PLANNED, rate)
    smooth = filter_low_pass(_at(even, log.t, log.q), _SMOOTH, rate)
    return rate, even, _at(even + _LAG, even, smooth)


def _at(t: Array, times: Array, x: Array) -> Array:
    return np.column_stack([np.interp(t, times, column) for column in x.T])


def constant(host: Host, size: int, rng: Rng) -> FaultyLogs | None:
    """An angle keeps one value: in all logs, in one, or beside its reference."""
    dof, tables = host.robot.dof, tables_of(host)
    moves = np.min([np.ptp(table["q"], axis=0) for table in tables], axis=0)
    free = [j for j in range(dof) if moves[j] > 0.1]
    if not free:
        return None
    joint = int(rng.choice(free))
    if size == 2:
        tables = [_referred(log) for log in host.logs]
    out = []
    for i, table in enumerate(tables):
        dead = {k: table[k].copy() for k in ("q", "qd") if k in table}
        if size != 1 or i == 0:
            for name, signal in dead.items():
                signal[:, joint] = 0.0 if name == "qd" else signal[0, joint]
        out.append(table | dead)
    return FaultyLogs("constant", (joint + 1,), out)


def with_held_joint(host: Host, rng: Rng) -> Host | None:
    """Return the arm with sound logs in which a joint is held, its encoder silent."""
    if host.plant is None:
        return None
    logs = []
    for i, family in enumerate(("fourier", "cyclic")):
        motion = make_motion(family, host.robot, DURATION, RATE, rng)
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


def torque_sign(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """Torque of one, two or all joints counts the other way round."""
    joints, also = _turnable(host, size, rng, "angle_sign")
    sign, right = turned(host.robot.dof, joints), tables_of(host)
    tables = changed(right, ("tau",), lambda x: x * sign)
    return FaultyLogs("torque_sign", joints, tables, right, also=also)


def angle_sign(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """Angles (and speeds) of one, two or all joints count the other way round."""
    joints, also = _turnable(host, size, rng, "torque_sign")
    sign, right = turned(host.robot.dof, joints), tables_of(host)
    tables = changed(right, ("q", "qd"), lambda x: x * sign)
    return FaultyLogs("angle_sign", joints, tables, right, also=also)


def _turnable(
    host: Host, size: int, rng: Rng, alternative: str
) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Draw joints whose turned angles are not the same as their turned torques.

    Where there are none, since the arm is its own mirror image, the other kind is as
    right an answer.
    """
    dof = host.robot.dof
    for _ in range(_TRIES):
        joints = some(rng, dof, (1, 2, dof)[size])
        sign = turned(dof, joints)
        if differ(host, lambda q: q * sign, lambda tau: tau * sign):  # noqa: B023
            return joints, ()
    return joints, (alternative,)


def joint_order(host: Host, size: int, rng: Rng) -> FaultyLogs | None:
    """Two torques, or all signals of two joints or three, are exchanged."""
    dof, right = host.robot.dof, tables_of(host)
    names = ("tau",) if size == 0 else _ALL
    for _ in range(_TRIES):
        joints = some(rng, dof, 3 if size == 2 else 2)
        order = np.arange(dof)
        order[[j - 1 for j in joints]] = np.roll([j - 1 for j in joints], 1)
        if differ(host, lambda q: q[:, order], lambda x: x[:, order], _SHOWS):  # noqa: B023
            tables = changed(right, names, lambda x: x[:, order])  # noqa: B023
            return FaultyLogs("joint_order", joints, tables, right)
    return None


def torque_unit(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """Torque in N mm or kgf cm, or divided by a factor for each joint (currents)."""
    if size < 2:
        return _scaled(host, "torque_unit", {"tau": (1e3, _KGF_CM)[size]})
    each = rng.uniform(8, 15, host.robot.dof)
    tables = changed(tables_of(host), ("tau",), lambda x: x / each)
    return FaultyLogs("torque_unit", (), tables)


def angle_unit(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """Degrees: of angles and speeds, of angles alone, or of some joints only."""
    right, degrees, dof = tables_of(host), 180 / np.pi, host.robot.dof
    if size < 2:
        names = ("q", "qd") if size == 0 else ("q",)
        return _scaled(host, "angle_unit", dict.fromkeys(names, degrees))
    joints = some(rng, dof, 2)
    factor = np.where(turned(dof, joints) < 0, degrees, 1.0)
    tables = changed(right, ("q", "qd"), lambda x: x * factor)
    return FaultyLogs("angle_unit", joints, tables, right)


def time_unit(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """Milliseconds, microseconds; a clock at half speed where speeds are logged."""
    known = "qd" in tables_of(host)[0]
    return _scaled(host, "time_unit", {"t": (1e3, 1e6, 2.0 if known else 1e-3)[size]})


def gear_ratio(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """Torques, angles, or both are of the motor; the robot file has the gears."""
    gears = np.round(rng.uniform(50, 160, host.robot.dof), 1)
    factors = ({"tau": 1 / gears}, {"q": gears, "qd": gears})
    factors = (*factors, factors[0] | factors[1])[size]
    toml = f"[joints]\ngear_ratio = {gears.tolist()}\n"
    faulty = _scaled(host, "gear_ratio", factors)
    return FaultyLogs("gear_ratio", (), faulty.tables, faulty.right, toml=toml)


def velocity_mismatch(host: Host, size: int, rng: Rng) -> FaultyLogs | None:
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
    return FaultyLogs("velocity_mismatch", where, tables, right, also=also)


def _scaled(host: Host, kind: str, factors: dict) -> FaultyLogs:
    right = tables = tables_of(host)
    for name, factor in factors.items():
        tables = changed(tables, (name,), lambda x: x * factor)  # noqa: B023
    return FaultyLogs(kind, (), tables, right)
