"""The effects that may be named, on which joints, and the price of the choice."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from residual.effects import load_effects
from residual.effects.base import Effect, EffectTrait, MotionSpan, PlacedEffect
from residual.evidence.columns import CandidateColumns, merge_groups
from residual.evidence.design import Design
from residual.evidence.priors import list_first_priors, list_forbidden_effects
from residual.evidence.thresholds import THRESHOLDS
from residual.model.nominal import NominalModel
from residual.recording import Array


@dataclass(frozen=True, eq=False, slots=True)
class Candidates:
    """Every candidate finding with its price."""

    # All of them: each shape of each effect on each joint, then the effects that are
    # also tried on all joints at once.
    groups: tuple[CandidateColumns, ...]
    price: Mapping[tuple, float]  # price of the choice [nats], by key
    # Key of each group, whether it is on several joints, and its price [nats].
    keys: tuple[tuple, ...] = field(init=False)
    unions: Array = field(init=False)
    costs: Array = field(init=False)

    def __post_init__(self) -> None:
        every = self.groups
        object.__setattr__(self, "keys", tuple(g.key for g in every))
        object.__setattr__(self, "unions", np.array([bool(g.parts) for g in every]))
        object.__setattr__(self, "costs", np.array([self.cost(g) for g in every]))

    def cost(self, group: CandidateColumns) -> float:
        """Price of a group [nats]; joints added together share one price."""
        return self.price[group.key] / group.fellows

    def beside(self, more: Sequence[CandidateColumns]) -> "Candidates":
        """The candidates with more groups."""
        price = float(np.log(len({*self.price, *(g.key for g in more)})))
        priced = {**self.price, **{g.key: price for g in more}}
        return replace(self, groups=(*self.groups, *more), price=priced)

    def without(self, names: Sequence[str]) -> "Candidates":
        """The candidates without some effects; unchanged if it has none of them."""
        if not any(g.effect.name in names for g in self.groups):
            return self
        kept = tuple(g for g in self.groups if g.effect.name not in names)
        return replace(self, groups=kept)

    def exclude_joints(self, joints: Collection[int], bodies: bool = True) -> "Candidates":
        """The candidates without those on some joints, alone or among others.

        Args:
            joints: The joints, from 0.
        """
        shut = set(joints)
        kept = (
            g
            for g in self.groups
            if not shut & set(g.joints) or not (bodies or g.effect.portable.bodies is None)
        )
        return replace(self, groups=tuple(kept))


def collect_candidates(
    design: Design, effects: Sequence[Effect], span: MotionSpan, dof: int
) -> Candidates:
    """Append the columns of all candidates to the design.

    A key costs the logarithm of the number of keys, and its shapes that of their number,
    since the best of many candidates gains evidence by chance.
    """
    placed = []
    for effect in effects:
        for joints in effect.candidates(dof, span.prismatic):
            anchor = joints[0] if joints else 0
            shapes = effect.shapes(span, anchor)
            placed += [PlacedEffect(effect, joints, shape) for shape in shapes]
    groups = design.add(placed)
    # Linear local effects that usually sit on every joint, as one candidate.
    single: dict[str, list[CandidateColumns]] = {}
    for g in groups:
        if EffectTrait.GROUPABLE in g.effect.traits and g.shape == ():
            single.setdefault(g.effect.name, []).append(g)
    together = [merge_groups(parts) for parts in single.values() if len(parts) == dof > 1]
    groups += together
    price = price_keys(groups, dof)
    # A model without the basic drive effects must gain all of them in one step, since
    # each alone leaves a residual that hides the others.
    drive_groups = [g for g in together if g.effect.drive_order]
    for count in range(2, len(drive_groups) + 1):
        for some in combinations(drive_groups, count):
            parts = [part for g in some for part in g.parts]
            label = " + ".join(g.effect.name for g in some)
            groups.append(merge_groups(parts, label))
            price[groups[-1].key] = sum(price[g.key] for g in some)
    return Candidates(tuple(groups), price)


def price_keys(groups: Sequence[CandidateColumns], dof: int) -> dict[tuple, float]:
    """Return the price of one of the keys, and of one of its shapes [nats].

    A link that differs from its given body is one of ``dof`` doubtful ones: it costs that
    many choices more than an undeclared effect. Without that price, exact values with
    one wrong link would win over values that are all slightly wrong.
    """
    variants = Counter(g.key for g in groups)
    price = {k: float(np.log(len(variants)) + np.log(n)) for k, n in variants.items()}
    for key in {g.key for g in groups if g.effect.replaces_link}:
        price[key] += float(np.log(dof))
    return price


def list_present_effects(span: MotionSpan, clocked: bool) -> list[Effect]:
    """List the effects that logs can show, by their clock and their drives."""
    absent = EffectTrait.NONE if clocked else EffectTrait.NEEDS_CLOCK
    if span.one_drive:
        absent |= EffectTrait.CHAIN
    return [e for e in load_effects().values() if not e.traits & absent]


def recompute_candidates(design: Design, candidates: Candidates) -> Candidates:
    """Recompute the candidates with the present torque model of the design.

    Only columns that depend on the model's torque are recomputed.
    """
    reading = [
        g for g in candidates.groups if EffectTrait.USES_MODEL in g.effect.traits and not g.parts
    ]
    recomputed = design.add([g.placed for g in reading])
    new = {_place(g): group for g, group in zip(reading, recomputed, strict=True)}

    def of(group: CandidateColumns) -> CandidateColumns:
        if not any(_place(p) in new for p in group.parts):
            return new.get(_place(group), group)
        parts = [new.get(_place(p), p) for p in group.parts]
        return merge_groups(parts, group.label)

    return replace(candidates, groups=tuple(of(g) for g in candidates.groups))


def _place(group: CandidateColumns) -> tuple:
    return group.effect.name, group.joints, group.shape, len(group.parts)


def build_candidates(
    design: Design, nominal: NominalModel, span: MotionSpan, clocked: bool
) -> Candidates:
    """Append the columns of all effects allowed by some prior.

    Args:
        clocked: Whether the order of the logs in time is known.
    """
    effects = list_present_effects(span, clocked)
    barred = [list_forbidden_effects(p, nominal) for p in list_first_priors(design, nominal)]
    allowed = [e for e in effects if not all(e.name in b for b in barred)]
    candidates = collect_candidates(design, allowed, span, design.dof)
    # If all values of a kind are off, this is their accuracy, not an effect.
    kinds = nominal.kinds
    groups = [g for g in candidates.groups if not any(p.effect.name in kinds for p in g.parts)]
    candidates = replace(candidates, groups=tuple(groups))
    # Joints that hardly move give no information.
    return candidates.exclude_joints(
        np.flatnonzero(design.rows < THRESHOLDS.min_rows), bodies=False
    )
