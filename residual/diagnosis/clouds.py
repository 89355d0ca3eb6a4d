"""Residual against the variable that explains it, for the report."""

from collections.abc import Sequence

import numpy as np

from residual.diagnosis.examine import Examined
from residual.diagnosis.findings import Named
from residual.evidence.fit import Fit
from residual.model.curves import Cloud
from residual.recording import Array


def clouds(
    examined: Examined, fitted: Fit, found: Sequence[Named]
) -> tuple[Cloud, ...]:
    """One cloud per finding and joint on which it acts most."""
    design = examined.task.design
    out = []
    for finding in found:
        for tested in finding.tested:
            group = tested.group
            joints = group.joints if group.effect.scope == "local" else (tested.joint,)
            for j in joints:
                place, have = design.present(j, group.ids)
                effect = design.columns(j, place) @ fitted.of(group)[have]
                left = design.residual(j, fitted.ids, fitted.theta)
                anchor = j if group.effect.scope == "local" else tested.joint
                x, label, log = _variable(examined, group.effect, anchor, j)
                out.append(
                    Cloud(
                        group.effect.name, j + 1, label, x, left + effect, effect, log
                    )
                )
    return tuple(out)


def _variable(
    examined: Examined, effect, anchor: int, j: int
) -> tuple[Array, str, Array]:
    """The explaining variable on the rows of joint j, and which log each is of."""
    values, labels, label = [], [], ""
    states = examined.task.design.states
    for track, state in zip(examined.logs.tracks, states, strict=True):
        x, label = effect.variable(state, anchor)
        rows = track.moving[:, j]
        values.append(x[:: track.step][rows])
        labels.append(np.full(int(rows.sum()), track.id))
    return np.concatenate(values), label, np.concatenate(labels)
