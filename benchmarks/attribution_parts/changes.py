"""What changes on an arm: one to four things, each clear of what logs would show."""

from collections.abc import Callable, Sequence

import numpy as np

from benchmarks.attribution_parts.arms import Arm, moved_values
from flows.blind.size import draw_sized, measured, smallest
from flows.blind.sums import CLEAR
from residual.diagnosis.result import Detectable
from residual.effects import reported_joints
from sim.catalogue import multiplied
from sim.draw import draw_hidden
from sim.records import PlantEffect

Rng = np.random.Generator

BODIES = PAYLOAD, LINK = "payload", "link_inertia"
DRIVES = {"rotor_inertia": "inertia", "coulomb": "level", "viscous": "coefficient"}
STRUCTURAL = ("stribeck", "load_friction", "spring", "offset", "torque_gain")
_KINDS = (PAYLOAD, LINK, "rotor_inertia", "coulomb", "viscous", "structural")
_SHARES = (0.18, 0.22, 0.15, 0.18, 0.12, 0.15)
_MOST_OF = {PAYLOAD: 1, LINK: 2, "structural": 1}
_LINK_SCALE = (0.12, 0.40)
_DRIVE_SCALE = {
    "rotor_inertia": (0.2, 1.0),
    "coulomb": (0.2, 1.5),
    "viscous": (0.2, 1.5),
}
_LEFT = 0.8  # of a drive's value may go, no more
_PAYLOAD_LARGEST = 0.08  # of the arm's mass
_TRIES, _ROUNDING = 30, 1e-6


def draw_changes(
    arm: Arm, rng: Rng, count: int, minimum: Sequence[Detectable]
) -> list[PlantEffect]:
    """Draw changes of three times their detectable size or more.

    A kind for which no joint has room between that size and what is plausible is drawn
    again as another.

    Args:
        minimum: What logs of the same motions would show of the arm, unchanged.
    """
    made: list[PlantEffect] = []
    for _ in range(_TRIES * count):
        if len(made) == count:
            break
        kind = str(rng.choice(_KINDS, p=_SHARES))
        if sum(_kind(e) == kind for e in made) == _MOST_OF.get(kind, count):
            continue
        one = _DRAW[kind](arm, rng, kind, minimum)
        if one is not None and not any(_same(one, other) for other in made):
            made.append(one)
    return made


def _kind(effect: PlantEffect) -> str:
    return "structural" if effect.name in STRUCTURAL else effect.name


def _same(one: PlantEffect, other: PlantEffect) -> bool:
    return (one.name, one.joints) == (other.name, other.joints)


def _payload(arm: Arm, rng: Rng, kind: str, minimum: Sequence[Detectable]):
    usual = draw_hidden(arm.robot, rng, PAYLOAD)
    values = dict(usual.parameters)
    weight = sum(body.mass for body in list(arm.robot.model.inertias)[1:])
    mass = _between(rng, _clear(arm, minimum, usual), _PAYLOAD_LARGEST * weight)
    if mass is None:
        return None
    sized = multiplied(PAYLOAD, values, mass / values["mass"])
    return PlantEffect(PAYLOAD, usual.joints, tuple(sorted(sized.items())))


def _link(arm: Arm, rng: Rng, kind: str, minimum: Sequence[Detectable]):
    joint = int(rng.integers(1, arm.robot.dof + 1))
    least, most = _LINK_SCALE
    one = PlantEffect(LINK, (joint,), (("scale", least),))
    size = _between(rng, max(least, _clear(arm, minimum, one)), most)
    if size is None:
        return None
    return PlantEffect(LINK, (joint,), (("scale", size * float(rng.choice([-1, 1]))),))


def _drive(arm: Arm, rng: Rng, kind: str, minimum: Sequence[Detectable]):
    """Draw a change of a declared value; down only where enough is left of it."""
    joint, key = int(rng.integers(1, arm.robot.dof + 1)), DRIVES[kind]
    given, there = moved_values(arm, ())[kind, joint]
    least, most = (share * given for share in _DRIVE_SCALE[kind])
    one = PlantEffect(kind, (joint,), ((key, least),))
    size = _between(rng, max(least, _clear(arm, minimum, one)), most)
    if size is None:
        return None
    # What was off before counts: the verdict compares with what is given.
    off = there - given
    down = bool(rng.uniform() < 0.3) and size + max(off, 0.0) < _LEFT * given
    change = -size - max(off, 0.0) if down else size + max(-off, 0.0)
    return PlantEffect(kind, (joint,), ((key, float(change)),))


def _structural(arm: Arm, rng: Rng, kind: str, minimum: Sequence[Detectable]):
    name = str(rng.choice(STRUCTURAL))
    one = draw_sized(arm.robot, rng, name, CLEAR, minimum)
    found = measured(one, minimum, arm.robot, None)
    return one if (found.multiple or 0.0) >= CLEAR - _ROUNDING else None


_DRAW: dict[str, Callable] = {
    PAYLOAD: _payload,
    LINK: _link,
    **dict.fromkeys(DRIVES, _drive),
    "structural": _structural,
}


def _clear(arm: Arm, minimum: Sequence[Detectable], effect: PlantEffect) -> float:
    """Three times the detectable size of an effect where it sits; inf where none is."""
    joints = reported_joints(effect.name, effect.joints, arm.robot.dof)
    least = smallest(minimum, effect.name, joints)
    return np.inf if least is None else CLEAR * float(least.value)


def _between(rng: Rng, least: float, most: float) -> float | None:
    """Draw a size, as many small ones as large by ratio; None where none fits."""
    if not least <= most:
        return None
    return float(least * (most / least) ** rng.uniform())
