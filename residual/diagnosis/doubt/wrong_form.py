"""Names whose own curve is another: they resemble what the logs show, and are not it.

A sensor with a dead zone looks like one of less gain, a stop that is leaned on like a
spring, as long as only the error is asked. Over the variable that it is drawn against
the name then leaves a curve that every log repeats, a third of what it explains.
No author's form of the same effect leaves so much.
"""

from collections.abc import Sequence

import numpy as np

from residual.diagnosis.gate import Tested
from residual.evidence.design import Design
from residual.evidence.fit import Fit
from residual.recording import Array
from residual.signals.track import Track

BINS = 16
PART = 0.35  # of the name's own torque on those rows
LEAST = 0.005  # of the joint's torque: what a model of any arm leaves
FEWEST = 8  # rows of a bin and log that count


def wrong_forms(
    design: Design, tracks: Sequence[Track], fitted: Fit, tested: Sequence[Tested]
) -> list[Tested]:
    """Return the names that leave a third of their own curve or more unexplained."""
    return [t for t in tested if _is_wrong(design, tracks, fitted, t)]


def _is_wrong(
    design: Design, tracks: Sequence[Track], fitted: Fit, tested: Tested
) -> bool:
    group = tested.group
    if not group.effect.of_one_variable:
        return False
    (j,) = group.joints
    place, have = design.present(j, group.ids)
    drawn = design.columns(j, place) @ fitted.of(group)[have]
    left = design.residual(j, fitted.ids, fitted.theta)
    x, log = _variable(design, tracks, tested, j)
    curve = _repeated(x, left, log)
    return curve > max(PART * np.std(drawn), LEAST * design.rms[j])


def _variable(
    design: Design, tracks: Sequence[Track], tested: Tested, j: int
) -> tuple[Array, Array]:
    """What the name is drawn against on the rows of a joint, and each row's log."""
    values, logs = [], []
    for i, (track, state) in enumerate(zip(tracks, design.states, strict=True)):
        x, _ = tested.group.effect.variable(state, j)
        rows = track.moving[:, j]
        values.append(x[:: track.step][rows])
        logs.append(np.full(int(rows.sum()), i))
    return np.concatenate(values), np.concatenate(logs)


def _repeated(x: Array, y: Array, log: Array) -> float:
    """Rms of the curve of y over x that one log has from the others [of y].

    Products of the means of one bin in different logs: noise, which no two logs share,
    averages out instead of adding up.
    """
    edges = np.quantile(x, np.linspace(0, 1, BINS + 1)[1:-1])
    place = np.searchsorted(edges, x)
    total, weight = 0.0, 0.0
    for b in range(BINS):
        mine = place == b
        counts = np.bincount(log[mine])
        sums = np.bincount(log[mine], y[mine], minlength=len(counts))
        enough = counts >= FEWEST
        means = sums[enough] / counts[enough]
        if len(means) > 1:
            pairs = len(means) * (len(means) - 1)
            product = (means.sum() ** 2 - (means**2).sum()) / pairs
            total += mine.sum() * product
            weight += mine.sum()
    return float(np.sqrt(max(total / weight, 0.0))) if weight else 0.0
