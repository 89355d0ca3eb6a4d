"""Other sets of effects that are as good as the named one, as what they differ by."""

from collections.abc import Sequence
from dataclasses import dataclass

from residual.diagnosis.causes.sets import near_sets
from residual.diagnosis.task import Task
from residual.evidence.design import Group
from residual.evidence.fit import Fit

Groups = tuple[Group, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Swap:
    """Some of the named effects, and what could stand in their place.

    Attributes:
        gone: The named ones.
        instead: What stands in their place; an empty one for nothing.
    """

    gone: Groups
    instead: tuple[Groups, ...]


def swaps(
    task: Task, fitted: Fit, told: Sequence[tuple[Group, Sequence[Group], int]]
) -> list[Swap]:
    """Return what other sets within 6 nats differ by, each difference once.

    Args:
        told: Named effects with their equivalents, which are no news here.
    """
    known = {(group.key, other.key) for group, near, _ in told for other in near}
    found: dict[tuple, tuple[Groups, list[Groups]]] = {}
    for one in near_sets(task, fitted):
        gone = _without(fitted.members, one.members)
        instead = _without(one.members, fitted.members)
        pair = tuple(g.key for g in (*gone, *instead))
        if not gone or (len(gone) == len(instead) == 1 and pair in known):
            continue
        key = tuple(g.key for g in gone)
        found.setdefault(key, (gone, []))[1].append(instead)
    return [Swap(gone, tuple(instead)) for gone, instead in found.values()]


def _without(members: Sequence[Group], others: Sequence[Group]) -> Groups:
    keys = {g.key for g in others}
    return tuple(g for g in members if g.key not in keys)
