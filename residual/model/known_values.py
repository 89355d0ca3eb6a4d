"""Values that a user knows for sure, as `[known]` of robot.toml and --known have them.

"payload.mass" = 2.8, "coulomb.2.level" = 8.0, "link.3.mass" = 4.1: a name, the joint
from 1 where the effect is of one joint, and a parameter. Of what the model is said to
have it is the value; of what may be found it is the value if it is found. Only what
the coefficients of an effect say linearly can be held: a mass, a level, a stiffness.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from residual.effects import registry
from residual.effects.base import Effect, Joints
from residual.errors import InputError, check_name, listed, shown
from residual.recording import Array
from residual.robot.robot import Robot

LINK, MASS = "link", "mass"
EXACT = 1e-3  # of the value: one standard deviation of what is known for sure
TRIES = 3  # random coefficients for each of an effect, that show what is linear


@dataclass(frozen=True, eq=False, slots=True)
class KnownValue:
    """One value."""

    name: str  # of the effect, or "link"
    joints: Joints  # from 0; empty where the effect is of no single joint
    key: str  # its parameter
    value: float  # in its SI unit
    row: Array  # the parameter is ``row @ theta``, (k,)


@lru_cache(maxsize=8)
def known_values(robot: Robot) -> tuple[KnownValue, ...]:
    """Return what is known of an arm and what it may have.

    Raises:
        InputError: If a value cannot be known so, with what can be.
        UnknownNameError: If there is no such effect or parameter.
    """
    return tuple(
        _read(word, value, robot) for word, value in robot.known_values.items()
    )


def refuse_baseline(robot: Robot) -> None:
    """Refuse the baseline of an arm with values that are known for sure.

    Raises:
        InputError: If there are any.
    """
    if robot.known_values:
        raise InputError(
            f"Known values ({listed(robot.known_values)}) belong to one state of the "
            "arm; a baseline compares two. Leave out --known, and [known] of "
            "robot.toml, or the baseline."
        )


def of_effect(robot: Robot, effect: Effect, joints: Joints) -> list[KnownValue]:
    """Return what is known of an effect on given joints."""
    every = [k for k in known_values(robot) if k.name == effect.name]
    # What is at the flange has one place, whichever joint it is counted with.
    out = [k for k in every if not k.joints or k.joints == joints]
    if effect.of_link and joints[0] in mass_of_links(robot):
        # A link whose mass is known is no other link.
        out.append(KnownValue(effect.name, joints, "", 0.0, np.ones(1)))
    return out


def mass_of_links(robot: Robot) -> dict[int, float]:
    """Return the links, from 0, whose mass is known [kg]."""
    return {k.joints[0]: k.value for k in known_values(robot) if k.name == LINK}


def known_prior(
    values: Sequence[KnownValue], precision: Array, change: bool
) -> tuple[Array, Array]:
    """Return what known values add to a usual prior: information K, and pull b.

    (P + K) is the precision of coefficients with mean (P + K)^-1 b.

    Args:
        precision: P, the usual prior's. Shape (k, k).
        change: Whether theta is a change of a value that the model has: then zero.

    Returns:
        Shapes (k, k), (k,).
    """
    information, pull = np.zeros(precision.shape), np.zeros(len(precision))
    for value_known in values:
        value = 0.0 if change else value_known.value
        before = value_known.row @ np.linalg.solve(precision, value_known.row)
        sd = EXACT * max(abs(value_known.value), EXACT * float(np.sqrt(before)))
        information += np.outer(value_known.row, value_known.row) / sd**2
        pull += value_known.row * value / sd**2
    return information, pull


def _read(word: str, value: float, robot: Robot) -> KnownValue:
    name, *middle, key = word.split(".") if "." in word else (word, "")
    check_name(name, (*registry(), LINK), f"effect in the known value '{word}'")
    if name == LINK:
        check_name(key, (MASS,), "parameter of a link that can be known")
        if not value > 0:
            raise InputError(f"Known {word} = {value:g}: expected a mass above 0 kg.")
        return KnownValue(name, _joint(word, middle, robot), key, value, np.ones(1))
    effect = registry()[name]
    rows = _rows(effect, robot)
    if not rows:
        able = ", ".join(n for n, e in registry().items() if _rows(e, robot))
        raise InputError(
            f"No value of {name} can be known: what its parameters do is not linear. "
            f"Expected one of link, {able}."
        )
    check_name(key, rows, f"parameter of {name} that can be known")
    if effect.scope == "local" or effect.scope == "link":
        joints = _joint(word, middle, robot)
    elif middle:
        raise InputError(f"Known {word}: {name} has no joint; write {name}.{key}.")
    else:
        joints = ()
    return KnownValue(name, joints, key, value, rows[key])


def _joint(word: str, middle: Sequence[str], robot: Robot) -> Joints:
    names = list(robot.model.names)[1:]
    text = ".".join(middle)
    if text in names:
        return (names.index(text),)
    if not text.isdigit() or not 1 <= int(text) <= robot.dof:
        first, *_, last = word.split(".") if "." in word else (word, "")
        raise InputError(
            f"Known {word}: joint {shown(text)} expected from 1 to {robot.dof} or a "
            f"joint of the URDF ({', '.join(names)}), as in {first}.2.{last}."
        )
    return (int(text) - 1,)


def _rows(effect: Effect, robot: Robot) -> dict[str, Array]:
    """Parameters that are linear in the coefficients, as rows. Shapes (k,)."""
    if effect.refine is not None:  # its coefficients mean another thing at each shape
        return {}
    rng = np.random.default_rng(0)
    start = rng.uniform(1, 2, len(effect.parameters))
    theta, shape = effect.from_values(start, robot)
    some = rng.uniform(0.5, 2, (TRIES * len(theta), len(theta)))
    values = np.array([effect.values(draw, shape, robot) for draw in some])
    rows, *_ = np.linalg.lstsq(some, values, rcond=None)
    miss = np.abs(some @ rows - values).max(axis=0)
    keys = zip(effect.parameters, rows.T, miss, strict=True)
    return {key: row.round(12) for key, row, gap in keys if gap < 1e-9}
