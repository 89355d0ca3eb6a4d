"""Samples that no arm can have made, log by log: spikes, and values that stand."""

import numpy as np

from residual.check.repaired import running_median
from residual.check.result import Fault
from residual.recording import Array, Recording

# Of what the samples do but for one in a hundred: noise of any shape stays below.
_SPIKE = 12.0
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
    # Quarters: the difference of two huge values must not overflow.
    x = x / 4
    away = np.abs(x - running_median(x))
    steps = np.sort(np.abs(np.diff(x)))
    usual = max(np.sort(away)[int(0.99 * len(away))], steps[int(0.99 * len(steps))])
    high = away > _SPIKE * max(usual, 1e-12)
    if not 0 < high.mean() <= _MOST + 3 / len(x):
        return np.array([], dtype=int), 0.0, float(usual)
    return np.flatnonzero(high), float(away.max()), float(usual)


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
