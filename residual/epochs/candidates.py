"""Every effect of the vocabulary that may have changed, on all joints."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from residual.effects import registry
from residual.effects.base import Effect, Shape
from residual.epochs.contrast import Candidate
from residual.epochs.joint import Joint, Piece
from residual.epochs.rows import Both
from residual.evidence.design import Design, Group
from residual.recording import Array


def vocabulary(both: Both, clocked: bool) -> tuple[list[Group], list[float]]:
    """Every effect that may have changed, on each joint and in each shape.

    Args:
        clocked: Whether each epoch's order of logs in time is known.

    Returns:
        The groups of columns, and what each costs as one of many [nats].
    """
    wanted, span, live = [], both.logs.span, set(both.live)
    for effect in registry().values():
        if effect.needs_clock and not clocked:
            continue
        for on in effect.candidates(both.design.dof):
            if effect.scope in ("local", "pair") and not set(on) <= live:
                continue
            shapes = _reaching(effect, effect.shapes(span, on[0] if on else 0))
            wanted += [(effect, on, shape) for shape in shapes]
    groups = both.design.add(wanted)
    variants = Counter(g.key for g in groups)
    prices = [
        float(np.log(len(variants)) + np.log(variants[g.key]))
        + (both.rules.link if g.effect.of_link else 0.0)
        for g in groups
    ]
    return groups, prices


def _reaching(effect: Effect, shapes: Sequence[Shape]) -> list[Shape]:
    """Shapes on a grid of ratios, up to the largest that the effect can have.

    A change may be larger than what an arm is delivered with.
    """
    out, how = list(shapes), effect.refine
    if how is None or how.step != "ratio" or len(out) < 2 or not np.isfinite(how.upper):
        return out
    ratio = out[-1][0] / out[-2][0]
    while ratio > 1 and out[-1][0] * ratio < how.upper:
        out.append((out[-1][0] * ratio, *out[-1][1:]))
    return out


def renewed(both: Both, known: Sequence[Candidate]) -> list[Group]:
    """The same groups, those that go by the model's torque seen anew."""
    old = [c.group for c in known]
    fresh = [g for g in old if g.effect.uses_model]
    made = iter(both.design.add([(g.effect, g.joints, g.shape) for g in fresh]))
    return [next(made) if g.effect.uses_model else g for g in old]


def refined(
    both: Both, joints: Mapping[int, Joint], one: Candidate, width: float
) -> list[Candidate]:
    """The same candidate with shapes about its own.

    Args:
        width: How far to look, as a part of the reach of its effect.
    """
    group = one.group
    how = group.effect.refine
    steps = width * how.reach * np.array([-1.0, -0.5, 0.5, 1.0])
    own = group.shape[0]
    first = own * np.exp(steps) if how.step == "ratio" else own + steps
    first = first[(first > how.lower) & (first < how.upper)]
    shapes = [(float(x), *group.shape[1:]) for x in first]
    made = both.design.add([(group.effect, group.joints, s) for s in shapes])
    before = [one.before if one.before is not group else g for g in made]
    return weighed(both.design, joints, made, [one.price] * len(made), before)


def weighed(
    design: Design,
    joints: Mapping[int, Joint],
    groups: Sequence[Group],
    prices: Sequence[float],
    before: Sequence[Group] = (),
) -> list[Candidate]:
    """Groups of the design's columns as candidates.

    Args:
        prices: What each costs [nats].
        before: What of each may have been there before; the same where none is given.
    """
    before = before or groups
    pieces: list[dict[int, Piece]] = [{} for _ in groups]
    for j, joint in joints.items():
        on = [i for i, g in enumerate(groups) if _acts(design, j, g)]
        if not on:
            continue
        ids = np.concatenate([groups[i].ids for i in on])
        was = np.concatenate([before[i].ids for i in on])
        own = _columns(design, j, ids)
        old = own if np.array_equal(ids, was) else _columns(design, j, was)
        sizes = [len(groups[i].ids) for i in on]
        made = joint.pieces(own, joint.layout.second, sizes, old)
        for i, piece in zip(on, made, strict=True):
            pieces[i][j] = piece
    every = zip(groups, pieces, prices, before, strict=True)
    return [Candidate(g, own, price, old) for g, own, price, old in every if own]


def _acts(design: Design, j: int, group: Group) -> bool:
    return len(design.present(j, group.ids)[0]) == len(group.ids)


def _columns(design: Design, j: int, ids: Array) -> Array:
    return design.columns(j, design.present(j, ids)[0])
