"""Logs that something else explains: balanced arms, zeros, gains; pairs of faults."""

from dataclasses import replace

import numpy as np

from benchmarks.check_parts import reports
from benchmarks.check_parts.arms import FaultyLogs, Host, changed, some, tables_of

Rng = np.random.Generator
_CARRIES = 0.1  # of the largest weight of a joint: below, a rough file is any factor off
_SHOWS = 0.5  # of the logged torque: below, weight does not show in it
_TRIES = 60


def balanced(host: Host, size: int, rng: Rng) -> FaultyLogs:
    """Counterweights or springs carry 60 to 100 % of one joint, two, or all of them."""
    dof = host.robot.dof
    share = np.zeros(dof)
    joints = some(rng, dof, (1, 2, dof)[size])
    share[[j - 1 for j in joints]] = rng.uniform(0.6, 1.0, len(joints))
    return reports.without_weight(host, share)


def zero(host: Host, size: int, rng: Rng) -> FaultyLogs | None:
    """The zero of one joint is 90, -90 or 180 degrees off, where that shows."""
    turn, right = (np.pi / 2, -np.pi / 2, np.pi)[size], tables_of(host)
    for _ in range(_TRIES):
        (joint,) = some(rng, host.robot.dof, 1)
        off = np.where(np.arange(host.robot.dof) == joint - 1, turn, 0.0)
        if _turns(host, off):
            tables = changed(right, ("q",), lambda q: q + off)  # noqa: B023
            return FaultyLogs("angle_zero", (joint,), tables, right)
    return None


def _turns(host: Host, off: np.ndarray) -> bool:
    q, tau = host.logs[0].q[::5], host.logs[0].tau[::5]
    moved = reports.weight_of(host, q) - reports.weight_of(host, q + off)
    return bool(np.any(np.sqrt(np.mean(moved**2, axis=0)) > 0.25 * np.std(tau, axis=0)))


def gain(host: Host, size: int, rng: Rng) -> FaultyLogs | None:
    """Torques of one to three joints are 0.25 to 4 times what they are.

    The weight shows it on one of them at least; on the others it may be named.
    """
    dof = host.robot.dof
    shows = _weight_shows(host)
    for _ in range(_TRIES):
        joints = some(rng, dof, size + 1)
        each = np.exp(rng.uniform(np.log(1.8), np.log(4.0), len(joints)))
        factor = np.ones(dof)
        factor[[j - 1 for j in joints]] = each ** rng.choice([-1, 1], len(joints))
        due = tuple(j for j in joints if shows[j - 1])
        if due:
            right = tables_of(host)
            tables = changed(right, ("tau",), lambda tau: tau * factor)  # noqa: B023
            return FaultyLogs("torque_scale", due, tables, right, may=joints)
    return None


def _weight_shows(host: Host) -> np.ndarray:
    """Which joints carry the arm, in motion that changes what they carry. (dof,)."""
    log = host.logs[0]
    weight = reports.weight_of(host, log.q[::5]).std(axis=0)
    heavy = weight > _CARRIES * weight.max()
    return heavy & (weight > _SHOWS * log.tau[::5].std(axis=0))


_FIRST = ("torque_sign", "angle_sign", "joint_order")
_THEN = (("torque_unit", 0), ("torque_unit", 1), ("angle_unit", 0), ("mounting", 2))


def pair(host: Host, size: int, rng: Rng) -> FaultyLogs | None:
    """A sign or an order of joints, and a unit or a mounting of all, at once."""
    one = getattr(reports, _FIRST[size])(host, 1 if size == 2 else 0, rng)
    kind, how = _THEN[rng.integers(len(_THEN))]
    if one is None:
        return None
    logs = zip(host.logs, one.tables, strict=True)
    read = replace(host, logs=tuple(replace(log, **table) for log, table in logs))
    both = getattr(reports, kind)(read, how, rng)
    return replace(both, right=one.right, beside=one)


EXPLAINED = {f.__name__: f for f in (balanced, zero, gain, pair)}
