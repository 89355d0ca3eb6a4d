"""Names that together are but a curve: a Fourier series is no physics.

A spring and ripples of several orders can draw any function of a joint's position, such
as a stop that the arm leans on. Where a free curve of as many numbers draws it as well,
the names say nothing that the curve does not, and none of them stands.
"""

from collections.abc import Sequence

import numpy as np

from residual.diagnosis.gate import KIN, Tested
from residual.evidence.design import Design
from residual.evidence.fit import Fit
from residual.recording import Array
from residual.signals.track import Track

STATIC = "static"  # the family of torques that depend on nothing but the position


def only_curves(
    design: Design,
    tracks: Sequence[Track],
    fitted: Fit,
    tested: Sequence[Tested],
) -> list[Tested]:
    """Return the names that a free curve of as many numbers could stand for.

    Looked at are joints with two or more names that depend on the position alone and
    a wave that repeats among them.
    """
    out = []
    for j in range(design.dof):
        mine = [t for t in tested if t.group.joints == (j,) and _of_position(t)]
        if len(mine) > 1 and any(t.group.effect.repeats for t in mine):
            left = design.residual(j, fitted.ids, fitted.theta)
            drawn = sum(_torque(design, fitted, t, j) for t in mine)
            numbers = sum(len(t.group.ids) + len(t.group.shape) for t in mine)
            lines = [x.q[:: x.step, j][x.moving[:, j]] for x in tracks]
            rest = _without_curve(np.concatenate(lines), left + drawn, numbers)
            had = ((left + drawn) ** 2).sum()
            explained = had - (left**2).sum()
            if had - (rest**2).sum() > KIN * explained:
                out += _waves(design, fitted, (mine, j), (left + drawn, explained))
    return out


def _waves(design: Design, fitted: Fit, names, target) -> list[Tested]:
    """Those of the names on a joint that draw the curve: all, or what rides on one.

    Where one name that is no wave explains nearly all of it, it is no drawing: the
    waves are what its textbook form leaves.
    """
    (mine, j), (whole, explained) = names, target
    for t in mine:
        left = ((whole - _torque(design, fitted, t, j)) ** 2).sum()
        alone = (whole**2).sum() - left
        if not t.group.effect.repeats and alone > KIN * explained:
            return [other for other in mine if other is not t]
    return mine


def _of_position(tested: Tested) -> bool:
    effect = tested.group.effect
    return effect.repeats or effect.family == STATIC


def _torque(design: Design, fitted: Fit, tested: Tested, j: int) -> Array:
    place, have = design.present(j, tested.group.ids)
    return design.columns(j, place) @ fitted.of(tested.group)[have]


def _without_curve(x: Array, y: Array, numbers: int) -> Array:
    """What straight lines between so many knots, evenly spaced, leave of y."""
    knots = np.linspace(x.min(), x.max(), max(numbers, 2))
    width = max(knots[1] - knots[0], 1e-12)
    hats = np.maximum(1 - abs(x[:, None] - knots) / width, 0)
    return y - hats @ np.linalg.lstsq(hats, y, rcond=None)[0]
