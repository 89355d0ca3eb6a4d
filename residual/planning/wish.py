"""A wish: an effect of some size that the next logs should not be able to hide."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.examine import Examined
from residual.effects import registry
from residual.errors import InputError
from residual.evidence.design import Group
from residual.evidence.fit import Fit, System
from residual.names import check_name, shortened
from residual.planning.gather import Basis, question_of
from residual.planning.question import Contest, Question
from residual.recording import Array

_FORM = re.compile(
    r"\s*(?P<name>\w+)\s*(?:@\s*(?P<joint>\d+))?\s*>=\s*(?P<value>\S+)\s*"
)


@dataclass(frozen=True, slots=True)
class Wish:
    """An effect that is to be seen if it is so large.

    Attributes:
        name: Its name.
        joint: Its joint from 1, the first of a pair; None for wherever it may be.
        value: Its first parameter, in the parameter's unit.
    """

    name: str
    joint: int | None
    value: float


def parse_wish(text: str) -> Wish:
    """Read "payload>=0.5" or "stribeck@3>=4".

    Raises:
        InputError: If it has another form.
        UnknownNameError: If no effect has that name.
    """
    found = _FORM.fullmatch(text)
    try:
        value = float(found["value"]) if found else np.nan
    except ValueError:
        value = np.nan
    if found is None or not (np.isfinite(value) and value > 0):
        raise InputError(
            f"--want '{shortened(text)}': expected NAME>=SIZE or NAME@JOINT>=SIZE with "
            "a size above 0, as in payload>=0.5."
        )
    name = check_name(found["name"], registry(), "effect in --want")
    joint = found["joint"]
    return Wish(name, int(joint) if joint else None, value)


def wished_question(examined: Examined, fitted: Fit, wish: Wish) -> Question:
    """Return the question whether an effect of that size is there or nothing.

    The logs so far count as if they were of an arm that has it: what they would have
    shown of it is the lead.

    Args:
        wish: The effect; on every joint where it may be, if it names none.

    Raises:
        InputError: If it cannot be there, is found already, or may not be blamed.
    """
    groups = _places(examined, fitted, wish)
    basis = Basis.of(examined, fitted, [*fitted.members, *groups])
    contests = [_contest(basis, g, wish.value) for g in groups]
    return question_of(basis, contests)


def _places(examined: Examined, fitted: Fit, wish: Wish) -> list[Group]:
    """One group of the effect for every place where it may be."""
    task = examined.task
    keys: dict[tuple, list[Group]] = {}
    for g in task.candidates.groups:
        if g.effect.name == wish.name and not g.parts:
            keys.setdefault(g.joints, []).append(g)
    named = {g.joints for g in fitted.members if g.effect.name == wish.name}
    at = None if wish.joint is None else wish.joint - 1
    found = [
        _nearest(groups, wish.value)
        for joints, groups in keys.items()
        if joints not in named and (at is None or joints[:1] == (at,))
    ]
    if found:
        return found
    where = "" if at is None else f" on joint {wish.joint}"
    why = "the model has it, or these logs may not blame it"
    if named:
        why = f"it is found on joints {[j + 1 for js in named for j in js]} already"
    raise InputError(
        f"--want {wish.name}: no candidate{where}: {why}. Name another effect or joint."
    )


def _nearest(groups: Sequence[Group], value: float) -> Group:
    """The shape that comes nearest where the size is a shape, else the middle one."""
    middle = groups[len(groups) // 2]
    effect = middle.effect
    if effect.refine is None or len(effect.parameters) > 1:
        return middle
    gaps = [abs(np.log(abs(g.shape[0] / value))) for g in groups]
    return groups[int(np.argmin(gaps))]


def _theta(examined: Examined, group: Group, value: float) -> Array:
    """Coefficients of an effect whose first parameter has that value. Shape (k,)."""
    effect, robot = group.effect, examined.logs.robot
    states = examined.task.design.states
    unit = np.eye(len(group.ids))[0]
    if effect.usual is not None:
        unit = effect.usual(states, group.joints)[0]
    size = abs(float(effect.values(unit, group.shape, robot)[0]))
    twice = abs(float(effect.values(2 * unit, group.shape, robot)[0]))
    return unit * (value / size if twice > 1.5 * size > 0 else value)


def _contest(basis: Basis, group: Group, value: float) -> Contest:
    """The effect of that size against nothing, as the logs so far would have it."""
    task, members, weight = basis.task, basis.fitted.members, basis.weight
    theta = _theta(basis.examined, group, value)
    contest = basis.contest(members, [group], group.joints[0] if group.joints else 0)
    found, none = contest.rivals[0], contest.nothing
    system = System.of(task.design, task.prior, (*members, group))
    total, k = np.tensordot(weight, system.gram, 1), len(group.ids)
    mixed, own = total[:-k, -k:], total[-k:, -k:]
    bent = np.linalg.solve(none.precision, mixed @ theta)
    beyond = own - mixed.T @ np.linalg.solve(none.precision, mixed)
    spread = np.linalg.slogdet(np.eye(k) + np.linalg.solve(group.precision, beyond))[1]
    lead = 0.5 * (theta @ beyond @ theta - spread) - task.candidates.cost(group)
    true = np.concatenate([none.mean, theta])
    return replace(
        contest,
        rivals=(
            replace(found, mean=true, nats=float(lead)),
            replace(none, mean=none.mean + bent),
        ),
        enough=task.rules.threshold,
    )
