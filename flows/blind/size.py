"""How large a hidden effect is: in multiples of the smallest that would be seen."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.result import Detectable
from residual.effects import reported_joints
from residual.robot.robot import Robot
from sim.catalogue import amount, multiplied, stated
from sim.draw import draw_hidden
from sim.records import PlantEffect

# An arm that has ten times as much as any is no arm; where noise is that large, the
# effect stays below the multiple that was asked for.
MOST = 3.0  # of a usual size


@dataclass(frozen=True, slots=True)
class Hidden:
    """What an arm hides.

    Attributes:
        effect: Effect, joints and parameters, as the plant takes them.
        joints: Its joints in the convention of the verdict.
        size: How much of it there is, None where that is no one number.
        unit: Unit of the size.
        multiple: The size in minimum detectable ones, None where none is known.
    """

    effect: PlantEffect
    joints: tuple[int, ...]
    size: float | None
    unit: str | None
    multiple: float | None


def smallest(
    minimum: Sequence[Detectable], name: str, joints: Sequence[int]
) -> Detectable | None:
    """Return an effect's smallest detectable size, None if no arm has as much."""
    wanted = sorted(joints)
    at = (d for d in minimum if d.name == name and sorted(d.joints) == wanted)
    return next((d for d in at if d.value is not None), None)


def draw_sized(
    robot: Robot,
    rng: np.random.Generator,
    name: str,
    multiple: float | None,
    minimum: Sequence[Detectable],
) -> PlantEffect:
    """Draw an effect of usual size and place, then make it so many times detectable.

    Where no minimum detectable size is known, or the effect's torque is not in
    proportion to any parameter, the usual size stays.

    Args:
        multiple: Wanted size in minimum detectable ones, None for the usual one.
        minimum: ``minimum_detectable`` of a verdict on the same motion.
    """
    drawn = draw_hidden(robot, rng, name)
    values = dict(drawn.parameters)
    usual = amount(name, values)
    least = smallest(minimum, name, reported_joints(name, drawn.joints, robot.dof))
    if multiple is None or usual is None or least is None:
        return drawn
    smallest_amount = stated(name, float(least.value))
    wanted = min(multiple * smallest_amount, MOST * usual)
    sized = multiplied(name, values, wanted / usual)
    return PlantEffect(name, drawn.joints, tuple(sorted(sized.items())))


def measured(
    effect: PlantEffect, minimum: Sequence[Detectable], robot: Robot, unit: str | None
) -> Hidden:
    """Return an effect with its size beside the smallest that would be seen."""
    joints = reported_joints(effect.name, effect.joints, robot.dof)
    name = effect.name
    there = amount(name, dict(effect.parameters))
    least = smallest(minimum, name, joints)
    if not there:
        return Hidden(effect, joints, None, unit, None)
    multiple = there / stated(name, float(least.value)) if least else None
    return Hidden(effect, joints, stated(name, there), unit, multiple)
