"""Samples that no arm can have made, log by log: spikes, and values that stand."""

import numpy as np

from residual.check.result import Fault
from residual.recording import Array, Recording

# Of the robust deviation of second differences: noise of any usual shape stays below.
_SPIKE = 40.0
_MOST = 0.002  # share of samples: more are not single ones


def spikes(recording: Recording) -> list[Fault]:
    """Find single samples that leave their neighbours by far, and come back.

    Args:
        recording: The log.
    """
    out = []
    for name in ("q", "qd", "tau"):
        signal = getattr(recording, name)
        if signal is None or len(signal) < 10:
            continue
        for j, column in enumerate(signal.T):
            at, size, usual = _single(column)
            if len(at):
                out.append(_spike(recording, f"{name}{j + 1}", (at, size, usual)))
    return out


def _single(x: Array) -> tuple[Array, float, float]:
    """Return the samples that stand out, by how much at most, and what is usual."""
    # Halves first: the difference of two huge values must not overflow.
    middle = x[1:-1] / 4 - x[:-2] / 8 - x[2:] / 8
    steps = np.sort(np.abs(np.diff(x / 4)))
    usual = max(np.median(np.abs(middle)) / 0.6745, steps[int(0.99 * len(steps))] / 4)
    high = np.abs(middle) > _SPIKE * max(usual, 1e-12)
    if not 0 < high.mean() <= _MOST + 3 / len(x):
        return np.array([], dtype=int), 0.0, usual
    return np.flatnonzero(high) + 1, float(np.abs(middle).max()), float(usual)


def _spike(recording: Recording, name: str, found: tuple[Array, float, float]) -> Fault:
    at, size, usual = found
    worst = int(at[len(at) // 2])
    words = (
        f"{name} leaves its neighbours for single samples, as near t = "
        f"{recording.t[worst]:.6g} s, by {size / max(usual, 1e-12):.3g} times what its "
        "samples usually do."
    )
    joint = int(name.lstrip("qdtau"))
    return Fault("spike", (joint,), False, words, (), recording.id)
