"""Faults of reading: signs, order, units, gears, scales, speeds."""

from collections.abc import Sequence

import numpy as np

from benchmarks.check_parts.arms import Host
from benchmarks.check_parts.reports import joints_swapped, motor_current
from benchmarks.check_parts.spoiled import (
    Spoiled,
    changed,
    some,
    tables_of,
    told_apart,
    turned,
)

Rng = np.random.Generator
_TRIES = 40


def torque_sign(host: Host, size: int, rng: Rng) -> Spoiled:
    """Torque of one, two or all joints counts the other way round."""
    joints, also = _turnable(host, size, rng, "angle_sign")
    sign, right = turned(host.robot.dof, joints), tables_of(host)
    tables = changed(right, lambda table: {"tau": table["tau"] * sign})
    return Spoiled("torque_sign", joints, tables, right, also=also)


def angle_sign(host: Host, size: int, rng: Rng) -> Spoiled:
    """Angles (and speeds) of one, two or all joints count the other way round."""
    joints, also = _turnable(host, size, rng, "torque_sign")
    sign, right = turned(host.robot.dof, joints), tables_of(host)
    names = ("q", "qd")
    tables = changed(right, lambda t: {k: t[k] * sign for k in names if k in t})
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
    """Two torques, two joints altogether, or three torques in a ring are exchanged.

    Sizes 3 to 5 exchange two joints altogether in further ways.
    """
    if size > 2:
        return joints_swapped(host, size - 3, rng)
    dof, right = host.robot.dof, tables_of(host)
    for _ in range(_TRIES):
        joints = some(rng, dof, (2, 2, 3)[size])
        order = np.arange(dof)
        order[[j - 1 for j in joints]] = np.roll([j - 1 for j in joints], 1)
        names = ("q", "qd", "tau") if size == 1 else ("tau",)
        if size != 1 or told_apart(host, lambda q: q[:, order], lambda x: x[:, order]):  # noqa: B023
            break
    else:
        return None
    tables = changed(right, lambda t: {k: t[k][:, order] for k in names if k in t})
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
    names = ("q", "qd")
    tables = changed(right, lambda t: {k: t[k] * factor for k in names if k in t})
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


def torque_scale(host: Host, size: int, rng: Rng) -> Spoiled:
    """Torque of one joint is 0.3, 0.5 or 2.5 times what it is."""
    right = tables_of(host)
    joint = some(rng, host.robot.dof, 1)
    factor = np.where(turned(host.robot.dof, joint) < 0, (0.3, 0.5, 2.5)[size], 1.0)
    tables = changed(right, lambda table: {"tau": table["tau"] * factor})
    return Spoiled("torque_scale", joint, tables, right)


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
    tables = changed(right, lambda t: {"qd": t["qd"][:, order] * factor})
    also = ("angle_unit",) if size == 1 else ()
    where = () if size == 1 else tuple(joints)
    return Spoiled("velocity_mismatch", where, tables, right, also=also)


def _scaled(host: Host, kind: str, factors: dict) -> Spoiled:
    right = tables_of(host)
    tables = changed(
        right, lambda t: {k: t[k] * f for k, f in factors.items() if k in t}
    )
    return Spoiled(kind, (), tables, right)
