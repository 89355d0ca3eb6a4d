"""A change of a simulated arm: which, where, and as large as asked for."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from benchmarks.changes_parts.added import rigid_body, shares, size_of, solved
from benchmarks.changes_parts.arms import SECOND, Truly, record, robot_of, truly
from benchmarks.changes_parts.case import Case, Planted
from residual.errors import ModelgapError
from residual.robot.robot import Robot
from sim.draw import draw_hidden
from sim.engine.records import PlantEffect
from sim.plant.catalogue import amount, multiplied
from sim.plant.sizes import sizes

Values = Mapping[str, float]
Rng = np.random.Generator

# What can change on an arm, in the order in which it is dealt out.
EFFECTS = (
    *("offset", "payload", "viscous", "delay", "torque_gain", "ripple", "stribeck"),
    *("encoder_offset", "coulomb", "base_tilt", "spring", "quadratic_viscous"),
    *("elasticity", "load_friction", "rotor_inertia", "coulomb_asymmetry"),
    *("link_inertia", "position_friction", "tool_force", "backlash"),
    *("viscous_asymmetry", "balancer", "coupled_friction", "presliding", "warmup"),
    "encoder_eccentricity",
)
UNNAMED = (
    *("x_vibration", "x_cogging_sum", "x_friction_jump", "x_wall", "x_square_wave"),
    *("x_random_walk", "x_dead_zone"),
)
ENGINE_ONLY = ("x_wall", "x_dead_zone")

# Parameters that torque grows with, where the plant's catalogue has no amount.
_AMPLITUDES = ("x_vibration", "x_square_wave", "x_random_walk", "x_cogging_sum")
_GROWS = {
    **dict.fromkeys(_AMPLITUDES, "amplitude"),
    **dict.fromkeys(("presliding", "x_friction_jump", "x_dead_zone"), "level"),
    "x_wall": "stiffness",
}
_EITHER_WAY = ("coulomb", "viscous", "rotor_inertia")

# What no arm has more of. Of the friction and rotors that it has (least and most):
_OF_OWN = {
    "coulomb": ("coulomb", -0.8, 4.0),
    "viscous": ("viscous", -0.8, 4.0),
    "rotor_inertia": ("rotor", -0.8, 4.0),
    "coulomb_asymmetry": ("coulomb", -0.9, 0.9),
    "viscous_asymmetry": ("viscous", -0.9, 0.9),
    "quadratic_viscous": ("viscous", 0.0, 4.0),
    "position_friction": ("coulomb", 0.0, 0.9),
    "stribeck": ("coulomb", 0.0, 3.0),
    "presliding": ("coulomb", 0.0, 4.0),
    "warmup": ("coulomb", 0.0, 4.0),
    "coupled_friction": ("coulomb", 0.0, 4.0),
    "x_friction_jump": ("coulomb", 0.0, 4.0),
}
# ... of the torque range of the joint (in 1/rad where it is a stiffness):
_OF_RANGE = {
    "ripple": 0.3,
    "balancer": 1.0,
    "spring": 1.0,
    "x_wall": 20.0,
    **dict.fromkeys(("offset", "x_dead_zone", *_AMPLITUDES), 0.5),
}
# ... and as such, in SI units:
MOST = {
    "delay": 0.040,  # s: a torque that comes later is no torque of that motion
    "encoder_offset": 0.15,  # rad
    "encoder_eccentricity": 0.06,  # rad
    "base_tilt": 0.25,  # rad
    "backlash": 0.010,  # rad, half of the play
    "torque_gain": 0.5,
    "load_friction": 0.4,
}
MOST_TWIST = 0.03  # rad of a gear under the torque range
_LEAST_LINK, _MOST_LINK = -0.5, 1.5
MOST_LOAD = 0.25  # of the mass that moves
_MOST_FORCE = 0.5  # of its weight


def drawn(
    case: Case, name: str, rng: Rng, target: float, apart: tuple[int, ...] = ()
) -> Planted | None:
    """Draw a change of a size (0: a usual one), None where the arm cannot have it."""
    robot, arm = robot_of(case.arm), truly(case)
    usual = draw_hidden(robot, rng, name)
    values = dict(usual.parameters)
    if name in _EITHER_WAY and rng.integers(2):
        values = times(name, values, -1.0)
    if set(usual.joints) & set(apart):
        return None
    if not target:
        fits = possible(name, values, robot, arm, usual.joints)
        return Planted(name, usual.joints, _sorted(values)) if fits else None
    case = replace(case, held_out=())
    plain = record(case, SECOND, (), exact=True)
    rigid = rigid_body(arm.model)

    def size_at(factor: float) -> float | None:
        many = times(name, values, factor)
        if not possible(name, many, robot, arm, usual.joints):
            return None
        effect = PlantEffect(name, usual.joints, _sorted(many))
        try:
            logs = record(case, SECOND, (effect,), exact=True)
        except ModelgapError:
            return None  # no arm that moves
        pairs = zip(logs, plain, strict=True)
        return size_of([shares(rigid, *pair) for pair in pairs], usual.joints)

    found = solved(size_at, target)
    if found is None:
        return None
    many = _sorted(times(name, values, found[0]))
    return Planted(name, usual.joints, many, found[1])


def as_effect(planted: Planted) -> PlantEffect:
    return PlantEffect(planted.name, planted.joints, planted.parameters)


def times(name: str, values: Values, factor: float) -> dict[str, float]:
    """Return the parameters of the same effect with so many times the torque."""
    if name in _GROWS:
        return {**values, _GROWS[name]: factor * values[_GROWS[name]]}
    return multiplied(name, values, factor)


def possible(
    name: str, values: Values, robot: Robot, arm: Truly, joints: tuple[int, ...]
) -> bool:
    rows = [j - 1 for j in joints] or [0]
    size = _signed(name, values)
    if name in _OF_OWN:
        what, least, most = _OF_OWN[name]
        own = float(getattr(arm.drives, what)[rows].min())
        return least * own <= size <= most * own
    if name in _SPECIAL:
        return _SPECIAL[name](size, robot, rows)
    if name in _OF_RANGE:
        return abs(size) <= _OF_RANGE[name] * float(sizes(robot).torque[rows].min())
    return abs(size) <= MOST.get(name, np.inf)


def _signed(name: str, values: Values) -> float:
    if name in _GROWS:
        return float(values[_GROWS[name]])
    size = amount(name, values) or 0.0
    main = next(iter(values.values())) if len(values) == 1 else None
    sign = -1.0 if main is not None and main < 0 else 1.0
    return sign * size


def _twist(size: float, robot: Robot, rows: list[int]) -> bool:
    # The amount of a soft gear is its compliance.
    return abs(size) * float(sizes(robot).torque[rows].max()) <= MOST_TWIST


def _weight(robot: Robot) -> float:
    return sum(body.mass for body in list(robot.model.inertias)[1:])


_SPECIAL: dict[str, Callable[[float, Robot, list[int]], bool]] = {
    "elasticity": _twist,
    "link_inertia": lambda size, robot, rows: _LEAST_LINK <= size <= _MOST_LINK,
    "payload": lambda size, robot, rows: 0 < size <= MOST_LOAD * _weight(robot),
    "tool_force": lambda size, robot, rows: size <= 9.81 * _MOST_FORCE * _weight(robot),
}


def _sorted(values: Values) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((key, float(value)) for key, value in values.items()))
