"""What an arm may hide: names, parameters, and where each may sit.

Names and keys are those of the vocabulary; ``x_...`` are outside of it. How each acts
stands where its physical level is: bodies, friction and torques, transmission, signals.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from residual.errors import InputError
from residual.names import check_keys, check_name
from residual.robot.robot import Robot
from sim.records import PlantEffect

Scope = Literal["joint", "pair", "flange", "global"]


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of perturbation.

    Attributes:
        needs: Parameters that must be given.
        may: Further parameters with their defaults.
        scope: Where it sits: on each of its joints, on a pair, the flange, or all.
        positive: Parameters that must be greater than zero.
    """

    needs: tuple[str, ...]
    may: Mapping[str, float] = field(default_factory=dict)
    scope: Scope = "joint"
    positive: tuple[str, ...] = ()


_TENSOR = dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), math.nan)
_CENTRE = dict.fromkeys(("com_x", "com_y", "com_z"), 0.0)
_TILT = dict.fromkeys(("tilt_x", "tilt_y"), 0.0)
_FORCE = dict.fromkeys(("x", "y", "z"), 0.0)
_PAIR = {"coefficient": 0.0, "inertia": 0.0, "sign": 1.0}
_WAVE = ("amplitude", "frequency")
_SPIKES = {"interval": 0.5, "width": 0.004}  # s: a spike is one sample of 250 Hz
# Changes of what cannot be below zero in all.
_AMOUNTS = ("viscous", "coulomb", "rotor_inertia")

KINDS: Mapping[str, Kind] = {
    "viscous": Kind(("coefficient",)),
    "coulomb": Kind(("level",)),
    "rotor_inertia": Kind(("inertia",)),
    "link_inertia": Kind(("scale",)),
    "payload": Kind(("mass",), _CENTRE | _TENSOR, "flange", ("mass",)),
    "offset": Kind(("torque",)),
    "coulomb_asymmetry": Kind(("level",)),
    "viscous_asymmetry": Kind(("coefficient",)),
    "quadratic_viscous": Kind(("coefficient",)),
    "power_viscous": Kind(("coefficient", "exponent")),
    "stribeck": Kind(("level", "velocity"), {"exponent": 2.0}, positive=("velocity",)),
    "load_friction": Kind(("coefficient",)),
    "position_friction": Kind(("cos", "sin")),
    "coupled_friction": Kind(("level",), _PAIR, "pair"),
    "presliding": Kind(("level", "displacement"), positive=("level", "displacement")),
    "warmup": Kind(("level", "time_constant"), positive=("time_constant",)),
    "spring": Kind(("stiffness",), {"rest": 0.0}),
    "balancer": Kind(("cos", "sin")),
    "ripple": Kind(("amplitude", "order"), {"phase": 0.0}),
    "torque_gain": Kind(("gain",)),
    "saturation": Kind(("level",), positive=("level",)),
    "encoder_offset": Kind(("angle",)),
    "encoder_eccentricity": Kind(("cos", "sin")),
    "elasticity": Kind(("stiffness",), positive=("stiffness",)),
    "backlash": Kind(("half_gap",), positive=("half_gap",)),
    "base_tilt": Kind((), _TILT, "global"),
    "delay": Kind(("delay",), scope="global", positive=("delay",)),
    "tool_force": Kind((), _FORCE, "global"),
    "x_dead_zone": Kind(("level",), positive=("level",)),
    "x_cogging_sum": Kind(("amplitude", "order"), scope="pair"),
    "x_vibration": Kind(_WAVE, {"phase": 0.0}),
    "x_square_wave": Kind(_WAVE),
    "x_wall": Kind(("angle", "stiffness"), {"side": 1.0}, positive=("stiffness",)),
    "x_random_walk": Kind(("amplitude",)),
    "x_friction_jump": Kind(("level",), {"share": 0.5}),
    "x_fault_frozen": Kind(()),
    "x_fault_drift": Kind(("rate",)),
    "x_fault_torque_bias": Kind(("torque",)),
    "x_fault_torque_gain": Kind(("gain",)),
    "x_fault_torque_spikes": Kind(("size",), _SPIKES, positive=("interval", "width")),
}


def parameters(effect: PlantEffect) -> dict[str, float]:
    """Return the parameters of a checked effect, defaults filled in."""
    return {**KINDS[effect.name].may, **dict(effect.parameters)}


def check_effect(effect: PlantEffect, robot: Robot) -> None:
    """Check name, joints, parameters and onset of one effect.

    Raises:
        UnknownNameError: On an unknown name or parameter, with the nearest valid one.
        InputError: On joints where it cannot sit, or a value that cannot be.
    """
    check_name(effect.name, KINDS, "effect of the plant")
    kind, given = KINDS[effect.name], dict(effect.parameters)
    check_keys(given, (*kind.needs, *kind.may), f"effect '{effect.name}'")
    for key in kind.needs:
        if key not in given:
            raise InputError(
                f"Effect '{effect.name}' needs '{key}'; it has "
                f"{', '.join(given) or 'no parameter'}. Give '{key}' in SI units."
            )
    for key, value in given.items():
        low = key in kind.positive and value <= 0
        if not math.isfinite(value) or low:
            wanted = "a number above 0" if key in kind.positive else "a finite number"
            raise InputError(
                f"Effect '{effect.name}': {key} is {value:g}, expected {wanted}."
            )
    if not (math.isfinite(effect.onset) and effect.onset >= 0):
        raise InputError(
            f"Effect '{effect.name}': onset is {effect.onset:g}, expected 0 s or later."
        )
    _check_joints(effect, kind.scope, robot.dof)
    _check_range(effect, given)
    _check_left(effect, given, robot)


def _check_joints(effect: PlantEffect, scope: Scope, dof: int) -> None:
    joints = effect.joints
    inside = all(isinstance(j, int) and 1 <= j <= dof for j in joints)
    unique = len(set(joints)) == len(joints)
    fits, wanted = {
        "joint": (len(joints) >= 1, f"one or more of 1 to {dof}"),
        "pair": (len(joints) == 2, f"two of 1 to {dof}"),
        "flange": (joints in ((), (dof,)), f"[{dof}]"),
        "global": (joints == (), "none"),
    }[scope]
    if not unique:
        raise InputError(
            f"Effect '{effect.name}' is on joints {list(joints)}: one stands twice."
        )
    if not (inside and fits):
        raise InputError(
            f"Effect '{effect.name}' is on joints {list(joints)}, expected {wanted}."
        )


def _check_range(effect: PlantEffect, given: Mapping[str, float]) -> None:
    """Refuse what no arm can be: weightless links, motors that push the other way."""
    for key, limit in (("gain", -1.0), ("scale", -1.0)):
        if given.get(key, 0.0) <= limit:
            raise InputError(
                f"Effect '{effect.name}': {key} is {given[key]:g}, expected more than "
                f"{limit:g}."
            )
    if abs(given.get("sign", 1.0)) != 1.0 or abs(given.get("side", 1.0)) != 1.0:
        raise InputError(f"Effect '{effect.name}': a sign is 1 or -1, nothing else.")
    if 0 < sum(key in given for key in _TENSOR) < len(_TENSOR):
        raise InputError(
            f"Effect '{effect.name}': give all of {', '.join(_TENSOR)} or none."
        )


def _check_left(effect: PlantEffect, given: Mapping[str, float], robot: Robot) -> None:
    """Refuse a change that would leave less than none of what the arm has."""
    declared = robot.declared.get(effect.name)
    for key, change in given.items():
        if effect.name not in _AMOUNTS or change >= 0:
            continue
        for joint in effect.joints:
            values = declared.values.get(key) if declared else None
            has = float(values[joint - 1]) if values is not None else 0.0
            if has + change < 0:
                raise InputError(
                    f"Effect '{effect.name}': {key} is {change:g} on joint {joint}, "
                    f"which has {has:g}; expected {-has:g} or more."
                )
