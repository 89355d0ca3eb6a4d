"""Angles that lie beyond their range, and whether a zero explains them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.check.motion import Motion
from residual.check.reading import Reading, as_given, judge
from residual.recording import Array, Recording
from residual.robot.robot import Robot

_SLACK = 0.2  # rad beyond the range
_STEP = 0.3  # rad between the zeros that are tried
_MOST = 16
_WORTH = 30.0  # nats that it must gain where the columns are as they should be


def beyond(robot: Robot, recordings: Sequence[Recording]) -> tuple[int, ...]:
    """Return joints (from 1) whose angles fit into their range, but lie beyond it.

    Args:
        robot: The arm.
        recordings: Its logs.
    """
    low, high = _ends(recordings)
    off = np.maximum(robot.lower - low, high - robot.upper) > _SLACK
    fits = high - low < robot.upper - robot.lower + _SLACK
    return tuple(int(j) + 1 for j in np.flatnonzero(off & fits))


def zero_explains(
    robot: Robot, motion: Motion, recordings: Sequence[Recording], best: Reading
) -> bool:
    """Whether another zero of one joint suits a log as well as other columns do.

    Args:
        robot: The arm.
        motion: Rows of its logs, as given.
        recordings: The logs.
        best: The other columns.
    """
    joints = beyond(robot, recordings)
    if len(joints) != 1:
        return False
    j = joints[0] - 1
    low, high = (ends[j] for ends in _ends(recordings))
    first, last = robot.lower[j] - low, robot.upper[j] - high
    count = min(_MOST, 2 + int(abs(last - first) / _STEP))
    given, other = as_given(robot.dof), judge(robot, motion, best).value
    other += _WORTH if best == given else 0.0
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
