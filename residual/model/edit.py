"""A model edited by hand: an effect taken out, or with other values; nothing refitted.

A low error is no explanation: a right cause can be taken out of its model, and what is
left predicts the arm without it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from residual.errors import InputError
from residual.model.term import Term
from residual.names import check_name
from residual.robot.robot import Robot

Terms = tuple[Term, ...]


def taken_out(terms: Terms, name: str, joints: Sequence[int] | None) -> Terms:
    """Return terms without an effect.

    One that was found goes; one that the nominal model has goes back to what it is
    there, and goes too where that is nothing.

    Args:
        joints: Joints from 1 to take it from; None for all.

    Raises:
        InputError: If it is not there.
        UnknownNameError: If no term has that name.
    """
    out = {id(term) for term in _terms_of(terms, name, joints)}
    back = (_before(term) if id(term) in out else term for term in terms)
    return tuple(term for term in back if term is not None)


def _before(term: Term) -> Term | None:
    if term.nominal is None or not term.nominal.theta.any():
        return None
    return term.nominal.as_nominal()


def with_values(
    terms: Terms,
    robot: Robot,
    where: tuple[str, Sequence[int] | None],
    values: Mapping[str, float],
) -> Terms:
    """Return terms with other physical parameters of an effect.

    Where a nominal value and a change of it are on the same joints, they become one.

    Args:
        where: Name of the effect, and joints from 1; None for all that have it.
        values: New value of each parameter to change, in its SI unit.

    Raises:
        InputError: If the effect is not there.
        UnknownNameError: If there is no such effect or parameter.
    """
    own = _terms_of(terms, *where)
    for key in values:
        check_name(key, own[0].effect.parameters, f"parameter of {where[0]}")
    changed: dict[int, Term] = {}
    for joints in dict.fromkeys(term.joints for term in own):
        first, *more = (term for term in own if term.joints == joints)
        alike = [t.theta for t in (first, *more) if t.shape == first.shape]
        known = replace(first, theta=np.sum(alike, axis=0)).parameters(robot) | values
        numbers = np.array([float(known[k]) for k in first.effect.parameters])
        theta, shape = first.effect.from_values(numbers, robot)
        theta = np.asarray(theta, dtype=float)
        changed[id(first)] = replace(first, theta=theta, shape=tuple(shape))
    gone = {id(term) for term in own} - set(changed)
    return tuple(changed.get(id(t), t) for t in terms if id(t) not in gone)


def _terms_of(terms: Terms, name: str, joints: Sequence[int] | None) -> list[Term]:
    names = dict.fromkeys(t.effect.name for t in terms)
    check_name(name, names, "effect of this model")
    own = [t for t in terms if t.effect.name == name]
    if joints is not None:
        own = [t for t in own if {j + 1 for j in t.joints} <= set(joints)]
    if not own:
        has = sorted({j + 1 for t in terms if t.effect.name == name for j in t.joints})
        raise InputError(
            f"The model has no {name} on joints {list(joints or ())}, but on {has}."
        )
    return own
