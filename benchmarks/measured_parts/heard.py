"""Can the logs show an added effect at all? An oracle that knows its column.

Plain least squares of all inertial parameters, rotors, friction and constants leaves
out one block after the other, without and with the true torque of the effect as one
more column on its joint. The logs show the effect if this lowers the error of that
joint by a tenth, in four of five blocks. Nothing but filter and regressor is the
program's.
"""

from collections.abc import Sequence

import numpy as np

from benchmarks.measured_parts import greedy
from residual.recording import Recording
from residual.robot.robot import Robot

Array = np.ndarray

FALL, BLOCKS = 0.10, 0.8  # of the error; of the blocks


def is_heard(fall: float, blocks: float) -> bool:
    return fall > FALL and blocks >= BLOCKS


def fall_of_error(
    robot: Robot, fit: Sequence[Recording], plus: Sequence[Array], joint: int
) -> tuple[float, float]:
    """Return by what share the left-out error falls, and in which share of the blocks.

    Args:
        fit: Logs without the effect.
        plus: Its torque in each of them [N m], (n, dof).
        joint: Its joint, from 1.
    """
    plain = greedy.PlainFit.of(robot, fit)
    columns, torque = [], []
    for track, log, more in zip(plain.tracks, fit, plus, strict=True):
        even = [np.interp(track.t - track.t[0], log.t - log.t[0], y) for y in more.T]
        effect = track.filter(np.column_stack(even))
        columns.append({("the effect", joint): effect[:, [joint - 1]]})
        torque.append(track.tau + effect)
    selection = greedy.Selection.of(plain, columns, torque)
    before, after = (selection.left_out(known)[:, joint - 1] for known in ((), (0,)))
    fall = 1 - np.sqrt(after.sum() / before.sum())
    return float(fall), float((after < before).mean())
