"""Consistency of time, angles and velocities, limits, and units of a robot file.

Over windows of a fifth of a second the angle must change by the integral of the
velocity: no derivative of a noisy signal is taken.
"""

from collections.abc import Sequence

import numpy as np

from residual.check.result import Fault, Repair, list_true_joints
from residual.check.sample_faults import compute_running_median
from residual.check.thresholds import CHECK
from residual.errors import join_with_commas
from residual.quantity import convert_to_sliding_unit
from residual.recording import Array, Recording, compute_speed_quantile, compute_usual_speeds
from residual.robot.dynamics import compute_last_joint_distance
from residual.robot.robot import Robot

_VELOCITY = "velocity_mismatch"
_SHARE, _USUAL = 0.99, 0.95  # of the samples, to ignore single ones
_EARTH = (9.6, 10.0)  # m/s^2
_WINDOW = 0.2  # s, window for comparing angles and velocities
_TIME_UNITS = {
    1e-3: "milliseconds",
    1e-6: "microseconds",
    1e-9: "nanoseconds",
    1e3: "seconds that were taken for milliseconds",
    1e6: "seconds that were taken for microseconds",
}
# Ratio of velocity to change of the angle, by the faulty unit.
_UNITS = {
    180 / np.pi: ("qd", "the velocities are in deg/s"),
    30 / np.pi: ("qd", "the velocities are in turns per minute"),
    1 / (2 * np.pi): ("qd", "the velocities are in turns per second"),
    np.pi / 180: ("q", "the angles are in degrees"),
}


def find_time_unit(robot: Robot, recordings: Sequence[Recording]) -> Fault | None:
    """Find an implausible time column, and the unit in which it is plausible."""
    logs = [r for r in recordings if len(r.t) > 2]
    if not logs:
        return None
    rate = float(np.median([1 / np.median(np.diff(r.t)) for r in logs]))
    # Over twenty samples: the unit of time is unknown yet.
    fastest = [compute_speed_quantile(r, max(1, min(20, len(r.t) // 10)), _USUAL) for r in logs]
    speed = float(np.max(fastest / robot.velocity_limit))
    usual = CHECK.slowest_hz <= rate <= CHECK.fastest_hz
    if usual and speed < CHECK.clock_speed_ratio * 5:
        return None
    fits = {
        f: abs(np.log(rate / f / 300.0))  # Hz, a usual rate
        for f in _TIME_UNITS
        if CHECK.slowest_hz <= rate / f <= CHECK.fastest_hz and speed / f < CHECK.clock_speed_ratio
    }
    if not fits or (usual and max(fits) < 1):
        return None
    scale = min(fits, key=fits.__getitem__)
    words = f"{rate:.3g} samples per second, the fastest joint at {speed:.2g} of its speed limit: "
    words += f"time looks like {_TIME_UNITS[scale]}."
    return Fault("time_unit", (), True, words, (Repair("t", scale=scale),))


def find_impossible_sample_rate(recordings: Sequence[Recording]) -> list[Fault]:
    """Find sample times too close together in any unit.

    Such logs are not evaluated: a filter of a tenth of a second would not fit into
    memory.
    """
    rate = max((1 / np.median(np.diff(r.t)) for r in recordings if len(r.t) > 1), default=0.0)
    if rate <= CHECK.fastest_hz:
        return []
    words = f"{rate:.3g} samples per second, expected at most {CHECK.fastest_hz:.3g} in "
    words += "any unit of time. Export the log again, with time."
    return [Fault("time_unit", (), True, words)]


def find_uneven_time_steps(recording: Recording) -> list[Fault]:
    """Find gaps in time and steps of unequal length."""
    steps = np.diff(recording.t)
    if len(steps) < 10:
        return []
    usual, words = float(np.median(steps)), []
    gaps = np.flatnonzero(steps > CHECK.gap_steps * usual)
    if len(gaps):
        worst, many = int(np.argmax(steps)), "s" if len(gaps) > 1 else ""
        largest = f"{steps[worst]:.3g} s at t = {recording.t[worst]:.6g} s"
        words.append(f"{len(gaps)} gap{many}, the largest {largest}")
    jitter = float(np.quantile(np.abs(steps - usual), 0.9)) / usual
    if jitter > CHECK.uneven_steps:
        words.append(f"a tenth of the steps are off by more than {100 * jitter:.0f} %")
    if not words:
        return []
    evidence = f"The steps of time are {1000 * usual:.4g} ms but for {', and '.join(words)}."
    return [Fault("clock", (), False, evidence, (), recording.id)]


def find_velocity_faults(recordings: Sequence[Recording]) -> list[Fault]:
    """Compare velocities with angles, all logs together."""
    logs = [r for r in recordings if r.qd is not None and len(r.t) > 20]
    pairs = [_windows(r) for r in logs]
    if not pairs or sum(len(change) for change, _ in pairs) < 10:
        return []
    change, integral = (np.concatenate(side) for side in zip(*pairs, strict=True))
    power = np.linalg.norm(change, axis=0), np.linalg.norm(integral, axis=0)
    if power[0].max() == 0:
        return []
    moving = (power[0] > 0.01 * power[0].max()) & (power[1] > 0)
    related = (change.T @ integral) / np.maximum(np.outer(*power), 1e-300)
    related[~moving] = 0.0
    order, swapped = _order(related, moving)
    return swapped + _slopes(change, integral[:, order], related[:, order], moving)


def _windows(recording: Recording) -> tuple[Array, Array]:
    """Change of the angle, and integral of the velocity, window by window."""
    t, q = recording.t, recording.q
    step = float(np.median(np.diff(t)))
    stride = min(max(1, round(_WINDOW / step)), max(1, len(t) // 20))
    mean = (recording.qd[1:] + recording.qd[:-1]) / 2
    travelled = np.cumsum(mean * np.diff(t)[:, None], axis=0)
    travelled = np.concatenate([np.zeros((1, q.shape[1])), travelled])
    late = np.diff(t[::stride]) > 1.5 * stride * step
    parts = (np.diff(x[::stride], axis=0)[~late] for x in (q, travelled))
    return tuple(parts)


def _order(related: Array, moving: Array) -> tuple[Array, list[Fault]]:
    """Find exchanged velocities, by matching each angle with its velocity."""
    own, same = np.diag(related), np.arange(len(related))
    value = np.abs(related) + 0.2 * np.eye(len(own))
    if np.all(value.argmax(axis=1) == same):
        return same, []
    from scipy.optimize import linear_sum_assignment

    order = linear_sum_assignment(value, maximize=True)[1]
    other = order != same
    joints, best = list_true_joints(other), np.abs(related[same, order])
    if not joints or (best < CHECK.velocity_correlation)[other & moving].any():
        return same, []
    words = (
        f"The velocities of joints {join_with_commas(joints)} follow the angles of other joints "
        f"(correlation with their own at most {np.abs(own[other]).max():.2f}, in the "
        f"order {join_with_commas(order + 1)} at least {best[other].min():.2f})."
    )
    repair = Repair("qd", order=tuple(int(i) + 1 for i in order))
    return order, [Fault(_VELOCITY, joints, True, words, (repair,))]


def _slopes(change: Array, integral: Array, related: Array, moving: Array) -> list[Fault]:
    """Find velocities whose sign or scale differs from the change of their angles."""
    own, power = np.diag(related), np.sum(change**2, axis=0)
    slope = np.sum(change * integral, axis=0) / np.maximum(power, 1e-300)
    good = moving & (np.abs(own) > CHECK.velocity_correlation)
    size = float(np.median(np.abs(slope[good]))) if good.any() else 1.0
    error = CHECK.factor_spread - 1
    alike = np.all(np.abs(np.abs(slope[good]) / size - 1) < CHECK.velocity_spread)
    out = []
    if good.sum() >= 2 and alike and abs(size - 1) > error:
        out.append(_common(size))
        slope = slope / size
    off = good & (np.abs(slope - 1) > error)
    turned = off & (np.abs(slope + 1) < error)
    for mask, certain in ((turned, True), (off & ~turned, True), (moving & ~good, False)):
        joints = list_true_joints(mask)
        which, repairs = f"The velocity of joints {join_with_commas(joints)}", ()
        if not joints:
            continue
        if mask is turned:
            words = f"{which} runs against the angle."
            repairs = (Repair("qd", joints, sign=(-1,) * len(joints)),)
        elif certain:
            sizes = [float(slope[j - 1]) for j in joints]
            words = f"{which} is {join_with_commas(sizes, '.4g')} times what the angle does."
            repairs = (Repair("qd", joints, scale=tuple(1 / size for size in sizes)),)
        else:
            least = min(abs(own[j - 1]) for j in joints)
            words = f"{which} is not the derivative of the angle (correlation {least:.2f}): "
            words += "filtered, late, or of something else."
        out.append(Fault(_VELOCITY, joints, certain, words, repairs))
    return out


def _common(size: float) -> Fault:
    """Find a common factor of all velocities: a unit, else the clock."""
    for unit, (signal, name) in _UNITS.items():
        if abs(size / unit - 1) < CHECK.velocity_spread:
            words = f"All velocities are {size:.4g} times what the angles do: {name}."
            repair = Repair(signal, scale=1 / unit if signal == "qd" else unit)
            return Fault("angle_unit", (), True, words, (repair,))
    scale = 1 / size
    near = float(f"{scale:.1g}")
    scale = near if abs(scale / near - 1) < CHECK.velocity_spread else scale
    words = f"All velocities are {size:.4g} times what the angles do in the time that is given: "
    words += f"time runs {size:.4g} times too slowly in this log."
    return Fault("time_unit", (), True, words, (Repair("t", scale=scale),))


def find_limit_violations(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Find joints beyond the limits of the robot file.

    Several successive samples at five times a limit of speed or torque are certain,
    since they are impossible.
    """
    share, words, joints, certain = _SHARE, [], set(), False
    low = np.min([np.quantile(r.q, 1 - share, axis=0) for r in recordings], axis=0)
    high = np.max([np.quantile(r.q, share, axis=0) for r in recordings], axis=0)
    beyond = np.maximum(robot.lower - low, high - robot.upper) > CHECK.range_rad
    for j in np.flatnonzero(beyond):
        joints.add(int(j) + 1)
        words.append(
            f"q{j + 1} runs from {low[j]:.3g} to {high[j]:.3g} rad, its range is "
            f"{robot.lower[j]:.3g} to {robot.upper[j]:.3g} rad"
        )
    speeds = [
        np.diff(r.q, axis=0) / np.diff(r.t)[:, None] if r.qd is None else r.qd for r in recordings
    ]
    usual_speed = compute_usual_speeds(recordings, share)
    torques = [r.tau for r in recordings]
    tau = np.max([np.quantile(np.abs(x), share, axis=0) for x in torques], axis=0)
    for does, signals, usual, limit, unit in (
        ("joint {} moves at", speeds, usual_speed, robot.velocity_limit, "rad/s"),
        ("tau{} reaches", torques, tau, robot.torque_limit, "N m"),
    ):
        # Values that survive a running median. If they are large throughout, the unit is
        # wrong, which other checks report.
        peak = np.max([np.abs(x).max(axis=0) for x in signals], axis=0)
        if (far := peak > CHECK.certain_ratio * limit).any():
            smooth = [compute_running_median(np.abs(x[:, far])).max(axis=0) for x in signals]
            peak[far] = np.max(smooth, axis=0)
        peak[usual > CHECK.limit_ratio * limit] = 0.0
        most = np.where(peak > CHECK.certain_ratio * limit, peak, usual)
        for j in np.flatnonzero(most > CHECK.limit_ratio * limit):
            joints.add(int(j) + 1)
            certain |= bool(peak[j] > CHECK.certain_ratio * limit[j])
            unit_of = convert_to_sliding_unit(unit) if robot.prismatic[j] else unit
            does_so = f"{does.format(j + 1)} {most[j]:.3g} {unit_of}"
            words.append(f"{does_so}, its limit is {limit[j]:.3g} {unit_of}")
    where = tuple(sorted(joints))
    return [Fault("out_of_range", where, certain, f"{'; '.join(words)}.")] if where else []


def find_joints_in_degrees(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Find single joints whose angles are plausible in degrees but not in radians."""
    speed = compute_usual_speeds(recordings, _SHARE) / robot.velocity_limit
    reach = np.max([np.abs(r.q).max(axis=0) for r in recordings], axis=0)
    limit = np.maximum(np.abs(robot.lower), np.abs(robot.upper))
    far = (speed > CHECK.certain_ratio) | (reach > CHECK.certain_ratio * limit)
    turned = float(np.deg2rad(1.0))
    inside = speed * turned < CHECK.limit_ratio
    inside &= reach * turned < limit + CHECK.range_rad
    joints = list_true_joints(far & inside)
    # If most joints are out of range, the cause is common to all, and physics decides.
    others = np.delete(speed, [j - 1 for j in joints])
    most = 2 * len(joints) > robot.dof
    if not joints or most or np.any(others > CHECK.limit_ratio):
        return []
    far, fast = (join_with_commas((x[j - 1] for j in joints), ".3g") for x in (reach, speed))
    words = (
        f"The angles of joints {join_with_commas(joints)} reach {far} rad, or {fast} times the "
        "speed limit: they are degrees."
    )
    repair = Repair("q", joints, scale=len(joints) * (turned,))
    return [Fault("angle_unit", joints, True, words, (repair,))]


def find_wrong_units(robot: Robot) -> list[Fault]:
    """Find a wrong unit of all masses or lengths of a robot file."""
    bodies = list(robot.model.inertias)[1:]
    mass, last = sum(b.mass for b in bodies), bodies[-1]
    reach = compute_last_joint_distance(robot.model) + np.linalg.norm(last.lever)
    if not reach:  # a wheel: its radius
        reach = np.sqrt(np.trace(last.inertia) / max(last.mass, 1e-9))
    density = mass / max(reach, 1e-6) ** 3  # kg/m^3 of the cube of the reach
    # A weight at the end of a lever has the density of a steel ball about the joint.
    densest = 1e3 if len(bodies) > 2 else 3e4
    for there, sizes, unit, scale in (
        (reach > 50.0, "lengths", "millimetres", 1e-3),
        (density > densest and reach > 0.05, "masses", "grams", 1e-3),
        (reach < 0.01 and mass > 1, "lengths", "kilometres", 1e3),
        (density < 1e-2, "masses", "tonnes", 1e3),
    ):
        if there:
            words = (
                f"The arm weighs {mass:.4g} kg and reaches {reach:.4g} m: its {sizes} "
                f"look like {unit}."
            )
            return [Fault("robot_file", (), True, words, (Repair("robot", scale=scale),))]
    return []


def find_wrong_gravity(robot: Robot) -> list[Fault]:
    """Find gravity in a robot file that differs in size from the earth's."""
    size = float(np.linalg.norm(robot.model.gravity.linear))
    if not size or _EARTH[0] < size < _EARTH[1]:
        return []
    words = f"Gravity is {size:.4g} m/s^2 in the robot file, expected 9.81."
    return [Fault("robot_file", (), size > 3 * _EARTH[1], words)]
