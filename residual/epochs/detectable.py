"""The size of a change of which half would be found in these logs."""

from collections.abc import Sequence
from itertools import product

import numpy as np

from residual.diagnosis.result import Detectable
from residual.effects.base import Effect
from residual.epochs.contrast import Candidate, expected_worth
from residual.epochs.search import Found
from residual.epochs.unrest import Warmth
from residual.recording import Array

LADDER = np.geomspace(1.0, 1e4, 400)  # deviations at which to look


def minimum_detectable(found: Found) -> list[Detectable]:
    """Smallest size of every effect and joint at which the evidence is expected.

    By the very information of the logs and the unrest of the first epoch by which a
    change is judged. Of several parameters of one unit it is the length, of a searched
    shape the usual one counts.
    """
    keys: dict[tuple, list[Candidate]] = {}
    for c in found.every:
        keys.setdefault((c.group.effect.name, c.group.joints), []).append(c)
    named = {(c.group.effect.name, c.group.joints) for c in found.named}
    out = []
    for key, some in keys.items():
        if key in named:
            continue
        size = _least(found, some[len(some) // 2])
        if size is not None:
            name, joints = key
            unit = next(iter(some[0].group.effect.parameters.values()))
            public = tuple(j + 1 for j in joints)
            out.append(Detectable(name, public, size, unit))
    return [*out, _of_warmth(found.warmth)]


def _of_warmth(warm: Warmth) -> Detectable:
    return Detectable("drift", (), 2 * warm.std, "1")


def _least(found: Found, one: Candidate) -> float | None:
    look = found.table.contrast(one, found.named)
    effect, robot = one.group.effect, found.both.design.model.robot
    sizes = []
    for way in _directions(effect, found, one):
        known = float(way @ look.information @ way)
        if known <= 0:
            continue
        per_unit, _ = found.share(one, way)
        if per_unit <= 0:
            continue
        scale = _smallest(found, one, way, look.information)
        if scale is not None:
            sizes.append(max(scale, found.both.rules.share / per_unit))
    if not sizes:
        return None
    size = float(np.median(sizes))
    if len(one.group.ids) > 1:
        return size
    return float(abs(effect.values(np.array([size]), one.group.shape, robot)[0]))


def _smallest(
    found: Found, one: Candidate, way: Array, information: Array
) -> float | None:
    """Size along a direction at which the expected evidence is the threshold."""
    unit = 1 / np.sqrt(float(way @ information @ way))
    sizes = unit * LADDER
    prior, nu = one.group.precision, found.table.degrees
    worth = expected_worth(information, way, prior, nu, sizes) - one.price
    seen = worth > found.both.rules.threshold
    return float(sizes[int(np.argmax(seen))]) if seen.any() else None


def _directions(effect: Effect, found: Found, one: Candidate) -> Sequence[Array]:
    """Coefficients of an effect of size one, in the ways that it usually comes."""
    count = len(one.group.ids)
    if effect.usual is not None:
        return effect.usual(found.both.design.states, one.group.joints)
    units = list(effect.parameters.values())[:count]
    alike = len(units) == count and len(set(units)) == 1
    if count == 1 or not (effect.repeats or alike):
        return [np.eye(count)[0]]
    every = [np.array(u, dtype=float) for u in product((-1, 0, 1), repeat=count)]
    half = every[len(every) // 2 + 1 :]  # the others point the other way
    return [u / np.linalg.norm(u) for u in half]
