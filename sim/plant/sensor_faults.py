"""Sensors that break during a run: encoders that the controller believes, torque logs.

A jump is an ``encoder_offset``, a fallen torque constant a ``torque_gain``, both with
an onset; here is what the vocabulary of effects has no word for. Nothing here acts
without an effect ``x_fault_...``: all other arms keep their bits.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sim.plant import tables as at
from sim.plant.perturbations import parameters
from sim.records import PlantEffect

Array = np.ndarray

FROZEN, DRIFT = "x_fault_frozen", "x_fault_drift"
_SLACK = 1e-9  # s: an onset on a step acts on that step


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


def encoder_faults(effects: Sequence[PlantEffect], dt: float) -> EncoderFaults | None:
    """Return the encoder faults among the effects that act, None if there are none."""
    frozen, drift = [], []
    for effect in effects:
        first = int(np.ceil(effect.onset / dt - 1e-6))
        for joint in (j - 1 for j in effect.joints):
            if effect.name == FROZEN:
                frozen.append((joint, first))
            elif effect.name == DRIFT:
                drift.append((joint, first, parameters(effect)["rate"]))
    if not frozen and not drift:
        return None
    return EncoderFaults(tuple(frozen), tuple(drift))


def hold_frozen(q: Array, t: Array, effects: Sequence[PlantEffect]) -> Array:
    """Return the log of the encoders where a frozen one repeats its last word.

    What is frozen is the number itself: the noise of the reading stands still too.

    Args:
        q: Positions with noise, rounded [rad]. Shape (n, dof).
        t: Times since the run began [s]. Shape (n,).
        effects: All effects of the arm.
    """
    if not any(effect.name == FROZEN for effect in effects):
        return q
    out = q.copy()
    for effect in effects:
        if effect.name == FROZEN:
            rows = [j - 1 for j in effect.joints]
            first = int(np.searchsorted(t, effect.onset - _SLACK))
            out[first:, rows] = out[max(first - 1, 0), rows]
    return out


def torque_faults(tau: Array, t: Array, effects: Sequence[PlantEffect]) -> None:
    """Change reports of torque in place: bias, gain, spikes.

    The drive itself works, and the controller does not read this sensor. Spikes come
    at the onset and then every ``interval``, each ``width`` long, with changing sign.

    Args:
        tau: Reported torque [N m]. Shape (n, dof).
        t: Times since the run began [s]. Shape (n,).
        effects: All effects of the arm.
    """
    for effect in effects:
        if not effect.name.startswith("x_fault_torque"):
            continue
        p, joints = parameters(effect), [j - 1 for j in effect.joints]
        first = int(np.searchsorted(t, effect.onset - _SLACK))
        if effect.name == "x_fault_torque_bias":
            tau[first:, joints] += p["torque"]
        elif effect.name == "x_fault_torque_gain":
            tau[first:, joints] *= 1.0 + p["gain"]
        elif effect.name == "x_fault_torque_spikes":
            since = t[first:] - effect.onset + _SLACK
            count, into = np.divmod(since, p["interval"])
            sign = np.where(count % 2 == 0, 1.0, -1.0) * (into < p["width"])
            tau[first:, joints] += p["size"] * sign[:, None]
