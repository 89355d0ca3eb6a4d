"""Is a name found again when any third of the data is left out?"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.diagnosis.gate import CLASS, Tested
from residual.diagnosis.result import Splits
from residual.diagnosis.search import admissible, best, torque_share
from residual.diagnosis.task import Task
from residual.evidence.design import Design, Group
from residual.evidence.fit import Fit, gain

PARTS = 3
SHARE = 1 - 1 / PARTS  # of the evidence that is left in what remains
SHOWN = 0.2  # share of an effect's power under which a part hardly shows it


def found_again(task: Task, fitted: Fit, tested: Sequence[Tested]) -> list[Splits]:
    """Leave out each third of the data and let each name win its place anew.

    Beside the other names it must again carry its threshold's share, help as a name
    must, and have no better rival than what cannot be told from it.
    """
    if not tested:
        return []
    found, of = np.zeros(len(tested), dtype=int), np.zeros(len(tested), dtype=int)
    for out in np.array_split(np.arange(task.design.folds), PARTS):
        part = task.design.part(np.setdiff1d(np.arange(task.design.folds), out))
        rules = replace(task.rules, threshold=SHARE * task.rules.threshold)
        one = replace(task, design=part, rules=rules)
        again = one.settle(one.fit(fitted.members, fitted, rounds=4))
        for i, t in enumerate(tested):
            shown = _shown(task.design, part, fitted, t.group)
            of[i] += shown
            found[i] += shown and _wins(one, again, t.group)
    return [Splits(int(k), int(n)) for k, n in zip(found, of, strict=True)]


def _wins(task: Task, fitted: Fit, group: Group) -> bool:
    """Whether a member would be named on these logs, beside the others."""
    rest = [g for g in fitted.members if g is not group]
    without = task.settle(task.fit(rest, fitted))
    value, big, small = gain(task.design, task.prior, fitted, without)
    own = value - task.candidates.cost(group)
    if own < task.rules.threshold or not admissible(task, group, value, big, small):
        return False
    rivals = best(task, without, instead=group)
    family = group.effect.family
    other = [v for v, g, _ in rivals if not family or g.effect.family != family]
    return max(other, default=-np.inf) < own + CLASS


def _shown(whole: Design, part: Design, fitted: Fit, group: Group) -> bool:
    """Whether a part of the logs has a fair share of an effect."""
    own, every = (
        np.sum(torque_share(design, fitted, group) ** 2 * design.rows)
        for design in (part, whole)
    )
    return bool(own > SHOWN * every)
