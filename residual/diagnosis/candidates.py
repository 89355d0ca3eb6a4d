"""Which effects may be blamed, on which joints, and what a wider choice costs."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from residual.effects import registry
from residual.effects.base import Effect, Span
from residual.evidence.columns import union
from residual.evidence.design import Design, Group
from residual.evidence.priors import forbidden, priors
from residual.evidence.rules import RULES
from residual.model.nominal import Nominal
from residual.recording import Array


@dataclass(frozen=True, eq=False, slots=True)
class Candidates:
    """Every candidate finding with its price.

    Attributes:
        groups: All of them: each shape of each effect on each joint, then the
            effects that are also tried on all joints at once.
        price: What choosing one of so many costs [nats], by key.
        keys, unions, costs: Of each group its key, whether it is one of several joints,
            and its price [nats].
    """

    groups: tuple[Group, ...]
    price: Mapping[tuple, float]
    keys: tuple[tuple, ...] = field(init=False)
    unions: Array = field(init=False)
    costs: Array = field(init=False)

    def __post_init__(self) -> None:
        every = self.groups
        object.__setattr__(self, "keys", tuple(g.key for g in every))
        object.__setattr__(self, "unions", np.array([bool(g.parts) for g in every]))
        object.__setattr__(self, "costs", np.array([self.cost(g) for g in every]))

    def cost(self, group: Group) -> float:
        """Price of a group [nats]; joints that came together share one price."""
        return self.price[group.key] / group.fellows

    def without(self, names: Sequence[str]) -> "Candidates":
        """The same without some effects; itself where it has none of them."""
        if not any(g.effect.name in names for g in self.groups):
            return self
        kept = tuple(g for g in self.groups if g.effect.name not in names)
        return replace(self, groups=kept)

    def closing(self, joints: Collection[int], bodies: bool = True) -> "Candidates":
        """The same without what sits on some joints, alone or among others.

        Args:
            joints: The joints, from 0.
        """
        shut = set(joints)
        kept = (
            g
            for g in self.groups
            if not shut & set(g.joints)
            or not (bodies or g.effect.portable.bodies is None)
        )
        return replace(self, groups=tuple(kept))

    def barring(self, fallen: Sequence[Group], kin: Sequence[Group]) -> "Candidates":
        """The same without some effects on their joints, alone or among others.

        Args:
            kin: Those of them with which all of their family on those joints goes: it
                would say the same, only worse.
        """
        keys = {g.key for g in fallen}
        families = {(g.effect.family, g.joints) for g in kin if g.effect.family}

        def falls(group: Group) -> bool:
            own = group.effect.family, group.joints
            return group.key in keys or own in families

        kept = (g for g in self.groups if not any(map(falls, g.parts or (g,))))
        return replace(self, groups=tuple(kept))


def collect(
    design: Design, effects: Sequence[Effect], span: Span, dof: int
) -> Candidates:
    """Append the columns of all candidates to the design.

    A key costs the logarithm of the number of keys, and its shapes that of their
    number: the evidence of the best of many is worth so much less.
    """
    wanted = []
    for effect in effects:
        for joints in effect.candidates(dof):
            anchor = joints[0] if joints else 0
            shapes = effect.shapes(span, anchor)
            wanted += [(effect, joints, shape) for shape in shapes]
    groups = design.add(wanted)
    together = _on_all_joints(groups, dof)
    groups += together
    variants = Counter(g.key for g in groups)
    price = {k: float(np.log(len(variants)) + np.log(n)) for k, n in variants.items()}
    # A model that lacks all that every drive has must gain it in one step, since each
    # alone leaves a residual in which the others cannot be seen.
    usual = [g for g in together if g.effect.usual_in_every_drive]
    for count in range(2, len(usual) + 1):
        for some in combinations(usual, count):
            parts = [part for g in some for part in g.parts]
            label = " + ".join(g.effect.name for g in some)
            groups.append(union(parts, label))
            price[groups[-1].key] = sum(price[g.key] for g in some)
    return Candidates(tuple(groups), price)


def renewed(design: Design, known: Candidates) -> Candidates:
    """The same candidates, seen with the model that the design looks with now.

    Only columns that read the model's torque are made anew.
    """
    old = [g for g in known.groups if g.effect.uses_model and not g.parts]
    fresh = design.add([(g.effect, g.joints, g.shape) for g in old])
    new = {_place(g): made for g, made in zip(old, fresh, strict=True)}

    def of(group: Group) -> Group:
        if not any(_place(p) in new for p in group.parts):
            return new.get(_place(group), group)
        parts = [new.get(_place(p), p) for p in group.parts]
        return union(parts, group.label)

    return replace(known, groups=tuple(of(g) for g in known.groups))


def _place(group: Group) -> tuple:
    return group.effect.name, group.joints, group.shape, len(group.parts)


def _on_all_joints(groups: Sequence[Group], dof: int) -> list[Group]:
    """The linear local effects that usually sit on every joint, as one candidate."""
    own: dict[str, list[Group]] = {}
    for g in groups:
        if g.effect.groupable and g.shape == ():
            own.setdefault(g.effect.name, []).append(g)
    return [union(parts) for parts in own.values() if len(parts) == dof > 1]


def every_candidate(
    design: Design, nominal: Nominal, span: Span, clocked: bool
) -> Candidates:
    """Append the columns of all effects that some prior allows.

    Args:
        clocked: Whether the order of the logs in time is known.
    """
    effects = [e for e in registry().values() if clocked or not e.needs_clock]
    barred = [forbidden(p, nominal) for p in priors(design, nominal)]
    wanted = [e for e in effects if not all(e.name in b for b in barred)]
    every = collect(design, wanted, span, design.dof)
    # Where all values of a kind are off, that is how good they are, and no effect.
    given = nominal.kinds
    kept = [g for g in every.groups if not any(p.effect.name in given for p in g.parts)]
    every = replace(every, groups=tuple(kept))
    # Of joints that hardly move the logs say nothing.
    return every.closing(np.flatnonzero(design.rows < RULES.fewest_rows), bodies=False)
