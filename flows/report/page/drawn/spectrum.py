"""Spectra of what the models leave of a joint's torque, before and after."""

from collections.abc import Sequence

import numpy as np
from scipy.signal import welch

from flows.report.page.drawn import look
from residual.model.compare import LogProof

HEIGHT = 280
_SEGMENT = 8.0  # s of one segment: lines an eighth of a hertz wide
_LEAST = 16  # samples of a segment


def spectrum_plot(
    proofs: Sequence[LogProof], joint: int, stages: Sequence[str]
) -> look.Plot | None:
    """Return the amplitude density of the residual of a joint; None of too little.

    Args:
        joint: Joint from 1.
    """
    traces, ceiling = [], 0.0
    for stage in stages:
        found = density(proofs, joint, stage)
        if found is None:
            return None
        f, amplitude = found
        points = {"x": look.packed(f[1:]), "y": look.packed(amplitude[1:])}
        traces.append(look.line(look.LABELS[stage], look.STAGES[stage], 1.6) | points)
        ceiling = max(ceiling, float(amplitude[1:].max()))
    x = look.axis("frequency (Hz)", rangemode="tozero")
    top = np.log10(ceiling) if ceiling > 0 else 0.0
    # Four decades: below is what the low-pass filter left, which tells nothing.
    y = look.axis("residual (N m/√Hz)", type="log", range=[top - 4, top + 0.2])
    y |= {"exponentformat": "power", "dtick": 1}
    layout = look.layout(f"Joint {joint}", x, y, hovermode="x")
    return {"data": traces, "layout": layout}


def density(
    proofs: Sequence[LogProof], joint: int, stage: str
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return frequencies [Hz] and amplitude density [N m/√Hz] of a residual.

    Welch's method (Welch 1967, IEEE Trans. Audio Electroacoust. 15, p. 70): the mean
    periodogram of overlapping Hann windows, here over all stretches without a gap.

    Args:
        joint: Joint from 1.
    """
    stretches = [s for p in proofs for s in _stretches(p, joint, stage)]
    if not stretches:
        return None
    rate = 1 / np.median([step for step, _ in stretches])
    length = min(int(_SEGMENT * rate), max(len(y) for _, y in stretches))
    usable = [y for _, y in stretches if len(y) >= length]
    if length < _LEAST:
        return None
    powers = [welch(y, rate, nperseg=length) for y in usable]
    weights = [len(y) for y in usable]
    power = np.average([p for _, p in powers], axis=0, weights=weights)
    return powers[0][0], np.sqrt(power)


def _stretches(proof: LogProof, joint: int, stage: str):
    """Yield step [s] and residual of every stretch of a log without a gap."""
    steps = np.diff(proof.t)
    if not len(steps):
        return
    step = float(np.median(steps))
    left = proof.tau[:, joint - 1] - proof.tau_hat[stage][:, joint - 1]
    for part in np.split(left, np.flatnonzero(steps > 1.5 * step) + 1):
        yield step, part
