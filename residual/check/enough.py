"""Whether a motion says enough: its length, its reversals, its joints apart."""

from collections.abc import Sequence

import numpy as np

from residual.check.motion import Motion
from residual.check.result import Fault
from residual.names import listed
from residual.recording import Recording

_SHORTEST = 7.5  # s of motion, all logs together
_ONE_WAY = 0.02  # share of a joint's path that does not count as a way back
_TRAVEL = 0.05  # rad: below it a joint stands
_TOGETHER = 0.998  # correlation of two speeds about zero


def enough(recordings: Sequence[Recording], motion: Motion | None) -> list[Fault]:
    """Find logs that are too short, and joints that do not move on their own.

    Args:
        motion: Their rows, None where nothing is left of them.
    """
    seconds = sum(r.duration for r in recordings)
    out = []
    if seconds < _SHORTEST:
        words = (
            f"The logs last {seconds:.3g} s together; below {_SHORTEST:g} s the motion "
            "does not tell friction, weight and inertia apart."
        )
        out.append(Fault("too_short", (), False, words))
    out += _one_way(recordings)
    if motion is not None:
        out += _lockstep(motion)
    return out


def _one_way(recordings: Sequence[Recording]) -> list[Fault]:
    """Joints that go one way only, apart from what their noise does."""
    forth, back = np.zeros((2, recordings[0].dof))
    for recording in recordings:
        step = max(1, len(recording.t) // 200)
        change = np.diff(recording.q[::step], axis=0)
        forth += np.maximum(change, 0).sum(axis=0)
        back += np.maximum(-change, 0).sum(axis=0)
    path = forth + back
    one_way = (np.minimum(forth, back) < _ONE_WAY * path) & (path > _TRAVEL)
    joints = tuple(int(j) + 1 for j in np.flatnonzero(one_way))
    if not joints:
        return []
    words = (
        f"Joints {listed(joints)} never reverse: dry friction and a constant torque "
        "cannot be told apart there."
    )
    return [Fault("no_reversal", joints, False, words)]


def _lockstep(motion: Motion) -> list[Fault]:
    qd = motion.qd[motion.moving.any(axis=1)]
    moves = np.flatnonzero(np.ptp(motion.q, axis=0) > _TRAVEL)
    if len(moves) < 2 or len(qd) < 10:
        return []
    unit = qd[:, moves] / np.maximum(np.linalg.norm(qd[:, moves], axis=0), 1e-12)
    related = np.abs(unit.T @ unit) - np.eye(len(moves))
    tied = (related > _TOGETHER).any(axis=0)
    if not tied.any():
        return []
    joints = tuple(int(j) + 1 for j in moves[tied])
    words = (
        f"The speeds of joints {listed(joints)} are proportional (correlation "
        f"{related.max():.4f}): what belongs to which of them cannot be told."
    )
    return [Fault("lockstep", joints, False, words)]
