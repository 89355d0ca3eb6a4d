"""Whether the logged velocity is the derivative of the logged angle.

Over windows of a fifth of a second the angle must change by the integral of the
velocity: no derivative of a noisy signal is taken.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.check.motion import Motion
from residual.check.reading import Reading, as_given, best_order, judge
from residual.check.result import Fault, Repair
from residual.check.rules import CHECK
from residual.names import listed
from residual.recording import Array, Recording, usual_speed
from residual.robot.robot import Robot

# Velocity over change of the angle: which signal is in which unit.
_UNITS = {
    180 / np.pi: ("qd", "the velocities are in deg/s"),
    30 / np.pi: ("qd", "the velocities are in turns per minute"),
    1 / (2 * np.pi): ("qd", "the velocities are in turns per second"),
    np.pi / 180: ("q", "the angles are in degrees"),
}


def velocity_faults(recordings: Sequence[Recording]) -> list[Fault]:
    """Compare velocities with angles, all logs together."""
    logs = [r for r in recordings if r.qd is not None and len(r.t) > 20]
    pairs = [_windows(r) for r in logs]
    if not pairs or sum(len(change) for change, _ in pairs) < 10:
        return []
    change, integral = (np.concatenate(side) for side in zip(*pairs, strict=True))
    power = np.sqrt(np.sum(change**2, axis=0)), np.sqrt(np.sum(integral**2, axis=0))
    if power[0].max() == 0:
        return []
    moved = (power[0] > 0.01 * power[0].max()) & (power[1] > 0)
    norm = np.maximum(np.outer(*power), 1e-300)
    related = (change.T @ integral) / norm
    related[~moved] = 0.0
    order, swapped = _order(related, moved)
    slopes = _slopes(change, integral[:, order], related[:, order], moved)
    return swapped + slopes


def _windows(recording: Recording) -> tuple[Array, Array]:
    """Change of the angle, and integral of the velocity, window by window."""
    t, q = recording.t, recording.q
    step = float(np.median(np.diff(t)))
    stride = min(max(1, round(CHECK.velocity_window / step)), max(1, len(t) // 20))
    mean = (recording.qd[1:] + recording.qd[:-1]) / 2
    travelled = np.cumsum(mean * np.diff(t)[:, None], axis=0)
    travelled = np.concatenate([np.zeros((1, q.shape[1])), travelled])
    late = np.diff(t[::stride]) > 1.5 * stride * step
    parts = (np.diff(x[::stride], axis=0)[~late] for x in (q, travelled))
    return tuple(parts)


def _order(related: Array, moved: Array) -> tuple[Array, list[Fault]]:
    """Velocities of other joints: each angle finds its own among them."""
    own = np.diag(related)
    sure = np.abs(related) + 0.2 * np.eye(len(own))
    order = best_order(sure)
    joints = tuple(j + 1 for j, i in enumerate(order) if i != j)
    best = np.abs(related[np.arange(len(own)), order])
    if not joints or any(
        best[j - 1] < CHECK.velocity_same for j in joints if moved[j - 1]
    ):
        return np.arange(len(own)), []
    words = (
        f"The velocities of joints {listed(joints)} follow the angles of other joints "
        f"(correlation with their own at most "
        f"{max(abs(own[j - 1]) for j in joints):.2f}, in the order "
        f"{listed(order + 1)} at least {min(best[j - 1] for j in joints):.2f})."
    )
    repair = Repair("qd", order=tuple(int(i) + 1 for i in order))
    return order, [Fault("velocity_mismatch", joints, True, words, (repair,))]


def _slopes(
    change: Array, integral: Array, related: Array, moved: Array
) -> list[Fault]:
    own = np.diag(related)
    slope = np.sum(change * integral, axis=0) / np.maximum(
        np.sum(change**2, axis=0), 1e-300
    )
    good = moved & (np.abs(own) > CHECK.velocity_same)
    off = good & (np.abs(slope - 1) > CHECK.velocity_off)
    out = []
    if off.any() and good.sum() == off.sum() and good.sum() >= 2:
        size = float(np.median(np.abs(slope[good])))
        if np.all(np.abs(np.abs(slope[good]) / size - 1) < CHECK.velocity_alike):
            out += _common(size)
            slope = slope / (size if out else 1.0)
            off = good & (np.abs(slope - 1) > CHECK.velocity_off)
    out += _single(slope, off)
    loose = tuple(int(j) + 1 for j in np.flatnonzero(moved & ~good))
    if loose:
        words = (
            f"The velocity of joints {listed(loose)} is not the derivative of the "
            f"angle (correlation {min(abs(own[j - 1]) for j in loose):.2f}): filtered, "
            "late, or of something else."
        )
        out.append(Fault("velocity_mismatch", loose, False, words))
    return out


def _common(size: float) -> list[Fault]:
    """One factor between all velocities and angles: a unit, else the clock."""
    if abs(size - 1) < CHECK.velocity_off:
        return []
    for unit, (signal, name) in _UNITS.items():
        if abs(size / unit - 1) < CHECK.velocity_alike:
            words = f"All velocities are {size:.4g} times what the angles do: {name}."
            scale = 1 / unit if signal == "qd" else unit
            repair = Repair(signal, scale=scale)
            return [Fault("angle_unit", (), True, words, (repair,))]
    scale = 1 / size
    near = float(f"{scale:.1g}")
    scale = near if abs(scale / near - 1) < CHECK.velocity_alike else scale
    words = (
        f"All velocities are {size:.4g} times what the angles do in the time that is "
        f"given: time runs {size:.4g} times too slowly in this log."
    )
    return [Fault("time_unit", (), True, words, (Repair("t", scale=scale),))]


def _single(slope: Array, off: Array) -> list[Fault]:
    out = []
    negated = tuple(
        int(j) + 1 for j in np.flatnonzero(off & (abs(slope + 1) < CHECK.velocity_off))
    )
    if negated:
        words = f"The velocity of joints {listed(negated)} runs against the angle."
        repair = Repair("qd", negated, sign=(-1,) * len(negated))
        out.append(Fault("velocity_mismatch", negated, True, words, (repair,)))
    scaled = tuple(int(j) + 1 for j in np.flatnonzero(off) if int(j) + 1 not in negated)
    if scaled:
        sizes = [float(slope[j - 1]) for j in scaled]
        words = (
            f"The velocity of joints {listed(scaled)} is "
            f"{listed([f'{s:.4g}' for s in sizes])} times what the angle does."
        )
        repair = Repair("qd", scaled, scale=tuple(1 / s for s in sizes))
        out.append(Fault("velocity_mismatch", scaled, True, words, (repair,)))
    return out


def out_of_range(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Find joints that are beyond the limits of the robot file."""
    beyond: dict[int, list[str]] = {}
    low = np.min(
        [np.quantile(r.q, 1 - CHECK.range_share, axis=0) for r in recordings], axis=0
    )
    high = np.max(
        [np.quantile(r.q, CHECK.range_share, axis=0) for r in recordings], axis=0
    )
    speed = np.max([_speeds(r) for r in recordings], axis=0)
    sizes = [np.quantile(np.abs(r.tau), CHECK.range_share, axis=0) for r in recordings]
    torque = np.max(sizes, axis=0)
    for j in range(robot.dof):
        said = beyond.setdefault(j + 1, [])
        if max(robot.lower[j] - low[j], high[j] - robot.upper[j]) > CHECK.range_angle:
            said.append(
                f"q{j + 1} runs from {low[j]:.3g} to {high[j]:.3g} rad, its range is "
                f"{robot.lower[j]:.3g} to {robot.upper[j]:.3g} rad"
            )
        if speed[j] > CHECK.range_limit * robot.velocity_limit[j]:
            said.append(
                f"joint {j + 1} moves at {speed[j]:.3g} rad/s, its limit is "
                f"{robot.velocity_limit[j]:.3g} rad/s"
            )
        if torque[j] > CHECK.range_limit * robot.torque_limit[j]:
            said.append(
                f"tau{j + 1} reaches {torque[j]:.3g} N m, its limit is "
                f"{robot.torque_limit[j]:.3g} N m"
            )
    joints = tuple(j for j, said in beyond.items() if said)
    if not joints:
        return []
    words = "; ".join(text for said in beyond.values() for text in said)
    return [Fault("out_of_range", joints, False, f"{words}.")]


def degrees(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Find single joints whose angles can be degrees but no radians."""
    speed = np.max([_speeds(r) for r in recordings], axis=0) / robot.velocity_limit
    reach = np.max([np.abs(r.q).max(axis=0) for r in recordings], axis=0)
    limit = np.maximum(np.abs(robot.lower), np.abs(robot.upper))
    beyond = (speed > CHECK.range_fast) | (reach > CHECK.range_far * limit)
    turned = float(np.deg2rad(1.0))
    inside = (speed * turned < CHECK.range_limit) & (
        reach * turned < limit + CHECK.range_angle
    )
    joints = tuple(int(j) + 1 for j in np.flatnonzero(beyond & inside))
    # Where most are far out, or the others are too, it is one thing for all, and
    # physics tells which.
    others = np.delete(speed, [j - 1 for j in joints])
    if not joints or 2 * len(joints) > robot.dof or np.any(others > CHECK.range_limit):
        return []
    words = (
        f"The angles of joints {listed(joints)} reach "
        f"{listed((reach[j - 1] for j in joints), '.3g')} rad, or "
        f"{listed((speed[j - 1] for j in joints), '.3g')} times the speed limit: "
        "they are degrees."
    )
    repair = Repair("q", joints, scale=len(joints) * (turned,))
    return [Fault("angle_unit", joints, True, words, (repair,))]


def _speeds(recording: Recording) -> Array:
    step = float(np.median(np.diff(recording.t)))
    stride = max(1, min(round(CHECK.range_stride / step), len(recording.t) // 4))
    return usual_speed(recording, stride, CHECK.range_share)


def beyond(robot: Robot, recordings: Sequence[Recording]) -> tuple[int, ...]:
    """Return joints (from 1) whose angles fit into their range, but lie beyond it."""
    low, high = _ends(recordings)
    off = np.maximum(robot.lower - low, high - robot.upper) > CHECK.range_angle
    fits = high - low < robot.upper - robot.lower + CHECK.range_angle
    return tuple(int(j) + 1 for j in np.flatnonzero(off & fits))


def zero_explains(
    robot: Robot, motion: Motion, recordings: Sequence[Recording], best: Reading
) -> bool:
    """Whether another zero of one joint suits a log as well as other columns do."""
    joints = beyond(robot, recordings)
    if len(joints) != 1:
        return False
    j = joints[0] - 1
    low, high = (ends[j] for ends in _ends(recordings))
    first, last = robot.lower[j] - low, robot.upper[j] - high
    count = min(CHECK.most_zeros, 2 + int(abs(last - first) / CHECK.zero_step))
    given, other = as_given(robot.dof), judge(robot, motion, best).value
    other += CHECK.zero_worth if best == given else 0.0
    for shift in np.linspace(first, last, count):
        q = motion.q.copy()
        q[:, j] += shift
        if judge(robot, replace(motion, q=q), given).nats >= other:
            return True
    return False


def _ends(recordings: Sequence[Recording]) -> tuple[Array, Array]:
    low = np.min([r.q.min(axis=0) for r in recordings], axis=0)
    high = np.max([r.q.max(axis=0) for r in recordings], axis=0)
    return low, high
