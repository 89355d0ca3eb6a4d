"""Whether a model predicts worse than another beyond chance: one rule for all of them.

Names that are judged, models that are adopted, headlines that must not hide a joint:
all ask whether an error rose. A rise counts from a twentieth on, and where two seconds
paired with the same two seconds show it at p < 0.01; of a log with fewer than eight
such pairs the size alone decides, since nothing else can.
"""

import numpy as np
from scipy.special import stdtrit

from residual.recording import Array

WORSE = 1.05  # times the error
SURE = 0.99  # one-sided, over paired blocks
BLOCK, FEW = 2, 8  # seconds of a block; blocks
SMALL = 1e-3  # of a joint's torque: less is within what no model is good for


def rise(after: Array, before: Array, worse: float = WORSE) -> float:
    """By how much an error is larger, as a share; 0 where by chance.

    Args:
        after: Squared errors per second. Shape (seconds,).
        before: The same of the other model. Shape (seconds,).
    """
    ratio = float(np.sqrt(after.sum() / max(before.sum(), 1e-300)))
    return ratio - 1 if ratio > worse and is_sure(after, before) else 0.0


def is_sure(after: Array, before: Array) -> bool:
    """Whether blocks of two seconds, each paired, show that one error is larger.

    Args:
        after: Squared errors per second. Shape (seconds,).
        before: The same of the other model. Shape (seconds,).
    """
    change = _blocks(after) - _blocks(before)
    # A block in which a joint stands says nothing.
    change = change[_blocks(after) + _blocks(before) > 0]
    if len(change) < FEW:
        return bool(change.sum() > 0)
    scatter = change.std(ddof=1) * np.sqrt(len(change))
    return bool(change.sum() > stdtrit(len(change) - 1, SURE) * scatter)


def rises(after: Array, before: Array, power: Array, least: float = SMALL) -> Array:
    """By how much each joint's error is larger, as a share; 0 where by chance. (dof,).

    Args:
        after: Squared errors per second [N^2 m^2]. Shape (seconds, dof).
        before: The same of the other model. Shape (seconds, dof).
        power: Squared torque on the same rows [N^2 m^2]; a joint without is not logged.
            Shape (dof,).
        least: Share of that torque by which an error must rise to count.
    """
    now, then = np.sqrt(after.sum(axis=0)), np.sqrt(before.sum(axis=0))
    clear = (power > 1e-12 * power.max(initial=0.0)) & (
        now - then > least * np.sqrt(power)
    )
    pairs = zip(after.T, before.T, clear, strict=True)
    return np.array([rise(a, b) if counts else 0.0 for a, b, counts in pairs])


def _blocks(seconds: Array) -> Array:
    """Sums of two seconds each; a last single second goes with the one before."""
    whole = max(len(seconds) // BLOCK, 1)
    starts = np.arange(whole) * BLOCK
    return np.add.reduceat(seconds, starts) if len(seconds) else seconds
