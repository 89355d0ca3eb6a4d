"""Whether angles, speeds and torques are within what the robot file allows.

Angles beyond their range may have another zero, rather than other columns.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.check.motion import Motion
from residual.check.reading import Reading, as_given, judge
from residual.check.result import Fault, Repair
from residual.check.rules import CHECK
from residual.names import listed
from residual.recording import Array, Recording, usual_speed
from residual.robot.robot import Robot


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
