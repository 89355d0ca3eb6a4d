"""The one place that reads `sim.effects`: names, values, checks, amounts."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, get_args

import pinocchio as pin

from residual.errors import InputError, check_keys, check_name
from residual.robot.robot import Robot
from sim.effects import load_effects
from sim.effects.base import Effect, Joints, OfDrive
from sim.engine.plant_records import PlantEffect, SyntheticEffect


class ActingEffect(NamedTuple):
    """An effect where it acts."""

    kind: Effect  # its entry in the catalogue
    values: Mapping[str, float]  # its values, defaults filled in
    joints: Joints  # its joints, from 0
    onset: float  # time from which it acts [s]


def list_plant_effects() -> dict[str, Effect]:
    """Return every effect that the plant can have, by name."""
    return load_effects()


def list_named_effects() -> list[str]:
    """Return the names of the effects that the diagnosis can name, sorted."""
    return sorted(name for name, effect in load_effects().items() if effect.named)


def check_effect_name(name: str) -> str:
    """Return the name if the plant has this effect; x_ marks effects outside the library.

    Raises:
        InputError: If not; the message lists the effects of the same kind.
    """
    effects, unnamed = load_effects(), name.startswith("x_")
    alike = [n for n in effects if n == name or n.startswith("x_") == unnamed]
    return check_name(name, alike, "effect of the plant")


def list_drive_effects() -> list[Effect]:
    """Return the effects that are parameters of every drive, in the order of `OfDrive`."""
    found = [effect for effect in load_effects().values() if effect.of_drive]
    return sorted(found, key=lambda effect: get_args(OfDrive).index(effect.of_drive))


def resolve_effects(effects: Iterable[PlantEffect | SyntheticEffect]) -> list[ActingEffect]:
    """Return checked effects with their entries in the catalogue."""
    return [
        ActingEffect(
            kind := load_effects()[e.name],
            {**kind.defaults, **dict(e.parameters)},
            tuple(joint - 1 for joint in e.joints),
            e.onset,
        )
        for e in effects
    ]


def apply_body_effects(model: pin.Model, effects: Sequence[ActingEffect]) -> pin.Model:
    """Return a copy with every load, changed link and tilt among the effects.

    Raises:
        InputError: If a load has a tensor that no body can have.
    """
    out = pin.Model(model)
    for kind, p, joints, _ in effects:
        if kind.body:
            out = kind.body(out, joints, p)
    return out


# -- impossible values ---------------------------------------------------------------


def check_effect(effect: PlantEffect, robot: Robot) -> None:
    """Check name, joints, parameters and onset of one effect."""
    check_effect_name(effect.name)
    kind, given = load_effects()[effect.name], dict(effect.parameters)
    check_keys(given, kind.parameters, f"effect '{effect.name}'")
    for key in kind.parameters:
        if key not in given and key not in kind.defaults:
            raise InputError(
                f"Effect '{effect.name}' needs '{key}'; it has "
                f"{', '.join(given) or 'no parameter'}. Give '{key}' in SI units."
            )
    if not (math.isfinite(effect.onset) and effect.onset >= 0):
        raise InputError(
            f"Effect '{effect.name}': onset is {effect.onset:g}, expected 0 s or later."
        )
    _check_values(kind, given)
    _check_joints(effect, robot.dof)
    _check_left(effect, given, robot)


def _check_values(kind: Effect, given: Mapping[str, float]) -> None:
    """Refuse impossible arms: weightless links, motors with reversed torque."""
    for key, value in given.items():
        limit = kind.above.get(key, -math.inf)
        if not math.isfinite(value) or value <= limit:
            expected = f"number above {limit:g}" if key in kind.above else "finite number"
            raise InputError(f"Effect '{kind.name}': {key} is {value:g}, expected a {expected}.")
    if any(abs(given.get(key, 1.0)) != 1.0 for key in kind.signs):
        raise InputError(f"Effect '{kind.name}': a sign is 1 or -1, nothing else.")
    if 0 < sum(key in given for key in kind.together) < len(kind.together):
        raise InputError(f"Effect '{kind.name}': give all of {', '.join(kind.together)} or none.")


def _check_joints(effect: PlantEffect, dof: int) -> None:
    joints = effect.joints
    inside = all(isinstance(j, int) and 1 <= j <= dof for j in joints)
    fits, expected = {
        "joint": (len(joints) >= 1, f"one or more of 1 to {dof}"),
        "pair": (len(joints) == 2, f"two of 1 to {dof}"),
        "flange": (joints in ((), (dof,)), f"[{dof}]"),
        "global": (joints == (), "none"),
    }[load_effects()[effect.name].scope]
    if len(set(joints)) < len(joints):
        raise InputError(f"Effect '{effect.name}' is on joints {list(joints)}: one appears twice.")
    if not (inside and fits):
        raise InputError(
            f"Effect '{effect.name}' is on joints {list(joints)}, expected {expected}."
        )


def _check_left(effect: PlantEffect, given: Mapping[str, float], robot: Robot) -> None:
    """Refuse a change that would make a parameter of the arm negative."""
    kind = load_effects()[effect.name]
    declared = robot.declared.get(effect.name)
    for key, change in given.items():
        if not kind.of_drive or change >= 0:
            continue
        for joint in effect.joints:
            values = declared.values.get(key) if declared else None
            has = float(values[joint - 1]) if values is not None else 0.0
            if has + change < 0:
                raise InputError(
                    f"Effect '{effect.name}': {key} is {change:g} on joint {joint}, "
                    f"which has {has:g}; expected {-has:g} or more."
                )
