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
from residual.signals.track import FilterSettings, build_tracks

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
    tracks, _ = build_tracks(list(fit), FilterSettings())
    base = [greedy.base_columns(robot, track) for track in tracks]
    moving = [abs(t.qd[:: t.step]) > greedy.STANDSTILL for t in tracks]
    theta = greedy.plain_fit(base, tracks, moving)
    noise = greedy.left_of_joints(base, tracks, moving, theta)
    blocks = []
    for track, log, more, x, moves in zip(tracks, fit, plus, base, moving, strict=True):
        even = [np.interp(track.t - track.t[0], log.t - log.t[0], y) for y in more.T]
        effect = track.filter(np.column_stack(even))
        true = np.zeros((*effect.shape, 1))
        true[:, joint - 1, 0] = effect[:, joint - 1]
        columns, torque = np.concatenate([x, true], axis=2), track.tau + effect
        for part in np.array_split(np.flatnonzero(track.valid), greedy.BLOCKS):
            weight = moves[part] / noise
            blocks.append((columns[part] * weight[:, :, None], torque[part] * weight))
    before, after = (_left_out(blocks, joint, drop) for drop in (1, 0))
    fall = 1 - np.sqrt(after.sum() / before.sum())
    return float(fall), float((after < before).mean())


def _left_out(blocks: Sequence[tuple[Array, Array]], joint: int, drop: int) -> Array:
    """Squared error of a joint in each block, fitted to the others. Shape (blocks,).

    Args:
        blocks: Weighted columns (n, dof, p) and torque (n, dof).
        drop: Number of last columns that are left away.
    """
    used = [(x[:, :, : x.shape[2] - drop], y) for x, y in blocks]
    gram = np.array([np.tensordot(x, x, ((0, 1), (0, 1))) for x, _ in used])
    cross = np.array([np.tensordot(x, y, ((0, 1), (0, 1))) for x, y in used])
    rows = sum(y.size for _, y in used)
    scale = 1 / np.sqrt(np.maximum(np.diag(gram.sum(axis=0)) / rows, 1e-12))
    ridge = greedy.RIDGE * rows * np.eye(len(scale))
    out = []
    for b, (x, y) in enumerate(used):
        others = (gram.sum(axis=0) - gram[b]) * scale[:, None] * scale + ridge
        right = scale * (cross.sum(axis=0) - cross[b])
        miss = y - x @ (scale * np.linalg.solve(others, right))
        out.append(np.square(miss[:, joint - 1]).sum())
    return np.array(out)
