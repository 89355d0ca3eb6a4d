"""Samples that no arm can have made, and logs without them, or in another unit."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from residual.check.result import Fault
from residual.check.rules import CHECK
from residual.names import joints_listed
from residual.recording import Array, Recording
from residual.robot.robot import Robot


def spikes(recording: Recording) -> list[Fault]:
    """Find single samples that leave their neighbours by far, and come back."""
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


def wraps(recording: Recording, robot: Robot) -> list[Fault]:
    """Find angles that leap by a whole turn between two samples: an encoder that wraps.

    Args:
        robot: The arm, for what its joints can do in a step.
    """
    leap = np.diff(recording.q, axis=0)
    whole = np.abs(np.abs(leap) - 2 * np.pi) < CHECK.whole_turn
    far = 2 * np.pi - CHECK.whole_turn > CHECK.too_far * np.outer(
        np.diff(recording.t), robot.velocity_limit
    )
    # Of an angle in other units many steps are large, and of any size.
    large = np.abs(leap) > np.pi
    found = (whole & far).any(axis=0) & (whole == large).all(axis=0)
    joints = tuple(int(j) + 1 for j in np.flatnonzero(found))
    if not joints:
        return []
    words = (
        f"The angle of {joints_listed(joints)} leaps by a whole turn between two "
        "samples: the encoder begins again there. Unwrap it before it is logged."
    )
    return [Fault("out_of_range", joints, True, words, (), recording.id)]


def _single(x: Array) -> tuple[Array, float, float]:
    """Return the samples that stand out, by how much at most, and what is usual."""
    # Quarters: the difference of two huge values must not overflow.
    x = x / 4
    away = np.abs(x - running_median(x))
    steps = np.sort(np.abs(np.diff(x)))
    usual = max(np.sort(away)[int(0.99 * len(away))], steps[int(0.99 * len(steps))])
    high = away > CHECK.spike * max(usual, 1e-12)
    if not 0 < high.mean() <= CHECK.most_spikes + 3 / len(x):
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


def with_scale(recording: Recording, signal: str, scale: float) -> Recording:
    """Return a log with one of its signals times a factor.

    Args:
        signal: "t", "q", "qd", "tau" or "q_ref".
    """
    return replace(
        recording, **{signal: np.asarray(getattr(recording, signal)) * scale}
    )


def without_spikes(recording: Recording) -> Recording:
    """Return a log smoothed by a running median, which no single sample survives."""
    names = ("q", "qd", "tau")
    signals = {name: getattr(recording, name) for name in names}
    smooth = {k: running_median(x) for k, x in signals.items() if x is not None}
    return replace(recording, **smooth)


def running_median(x: Array) -> Array:
    """Return the median over each sample and its neighbours.

    Args:
        x: Samples along the first axis. Shape (n,) or (n, dof).
    """
    window = (CHECK.median_window,) + (1,) * (x.ndim - 1)
    return median_filter(x, window, mode="nearest")
