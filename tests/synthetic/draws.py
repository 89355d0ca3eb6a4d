"""Draw hidden effects: which, on which joints, and how large."""

from collections.abc import Sequence
from functools import cache
from typing import Any

from residual.effects import load_effects
from residual.effects import number_reported_joints as number_joints
from residual.robot.robot import Robot
from residual.verdict.result import Detectable
from sim.effects.base import Rng
from sim.engine.plant_records import PlantEffect
from sim.plant.effect_catalogue import list_plant_effects
from sim.plant.typical_sizes import draw_plant_effect
from tests.synthetic.amounts import (
    compute_effect_amount,
    convert_stated_size,
    list_unnamed_effects,
    scale_effect,
)

# An arm that has ten times as much as any is no arm.
MOST = 3.0  # of a usual size


@cache
def vocabulary(robot: Robot) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what may be drawn: effects that have a name, and those that have none.

    The first are all that the diagnosis looks for and the plant can have.
    """
    named = [
        name
        for name, effect in sorted(load_effects().items())
        if name in list_plant_effects() and effect.candidates(robot.dof)
    ]
    # A broken sensor is the monitor's matter, and some of its faults have names here.
    return tuple(named), tuple(sorted(list_unnamed_effects()))


def draw_detectable(
    robot: Robot, rng: Rng, name: str, minimum: Sequence[Detectable]
) -> PlantEffect | None:
    """Draw an effect of exactly its minimum detectable size on the same motions.

    None where none is known, its torque is in proportion to no parameter, or no arm has
    as much.
    """
    drawn = draw_plant_effect(robot, rng, name)
    usual = compute_effect_amount(name, dict(drawn.parameters))
    joints = sorted(number_joints(name, drawn.joints, robot.dof))
    at = (d.value for d in minimum if d.name == name and sorted(d.joints) == joints)
    least = next((value for value in at if value is not None), None)
    if usual is None or least is None:
        return None
    factor = convert_stated_size(name, float(least)) / usual
    return scale_effect(drawn, factor) if factor <= MOST else None


def true_parameters(effect: PlantEffect, true: Any, told: Any) -> dict[str, float]:
    """Return the parameters of a hidden effect as a verdict states them.

    Friction and rotors of an arm are scattered about what its maker says. What they
    differ by is no part of the effect that was hidden, but of what is found.

    Args:
        true: Friction and rotors of the arm by joint.
        told: The same as declared.
    """
    values, kind = dict(effect.parameters), list_plant_effects().get(effect.name)
    if kind is not None and kind.of_drive:
        there, known = (getattr(each, kind.of_drive) for each in (true, told))
        joint = effect.joints[0] - 1
        values[kind.amount[0]] += float(there[joint] - known[joint])
    return values
