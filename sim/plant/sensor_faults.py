"""Encoders that break during a run, and that the controller believes.

Nothing here acts without a frozen or drifting encoder: all other arms keep their bits.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sim.catalogue import Acting
from sim.plant import tables as at
from sim.synthetic.sensors import SLACK

Array = np.ndarray


class EncoderFaults(NamedTuple):
    """Encoders that lie from a step on.

    Attributes:
        frozen: Joint from 0 and first step of each that stands still.
        drift: Joint from 0, first step and rate [rad/s] of each that wanders off.
    """

    frozen: tuple[tuple[int, int], ...]
    drift: tuple[tuple[int, int, float], ...]

    def read(self, k: int, dt: float, rows: Array) -> None:
        """Change what the controller reads on step k; rows are the trace so far."""
        now = rows[k]
        for joint, first, rate in self.drift:
            now[at.READING, joint] -= rate * (k - first) * dt
            now[at.READING_RATE, joint] -= rate
        for joint, first in self.frozen:
            now[at.READING, joint] = rows[max(first - 1, 0), at.READING, joint]
            now[at.READING_RATE, joint] = 0.0


def encoder_faults(effects: Sequence[Acting], dt: float) -> EncoderFaults | None:
    """Return the encoder faults among the effects that act, None if there are none."""
    frozen, drift = [], []
    for what, p, joints, onset in effects:
        first = int(np.ceil(onset / dt - 1e-6))
        if what.frozen:
            frozen += [(joint, first) for joint in joints]
        if what.drift:
            drift += [(joint, first, what.drift(p)) for joint in joints]
    if not frozen and not drift:
        return None
    return EncoderFaults(tuple(frozen), tuple(drift))


def hold_frozen(q: Array, t: Array, effects: Sequence[Acting]) -> Array:
    """Return the log of the encoders where a frozen one repeats its last word.

    What is frozen is the number itself: the noise of the reading stands still too.

    Args:
        q: Positions with noise, rounded [rad]. Shape (n, dof).
        t: Times since the run began [s]. Shape (n,).
        effects: All effects of the arm.
    """
    if not any(effect.what.frozen for effect in effects):
        return q
    out = q.copy()
    for what, _, joints, onset in effects:
        if what.frozen:
            first, rows = int(np.searchsorted(t, onset - SLACK)), list(joints)
            out[first:, rows] = out[max(first - 1, 0), rows]
    return out
