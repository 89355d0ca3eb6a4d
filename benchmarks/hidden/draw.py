"""Draw hidden effects: which, on which joints, and how large."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from residual.effects import load_effects
from residual.effects import number_reported_joints as number_joints
from residual.robot.robot import Robot
from residual.verdict.result import Detectable
from sim.effect_draws import draw_plant_effect
from sim.engine.plant_records import PlantEffect, PlantSpec
from sim.plant.effect_catalogue import (
    compute_effect_amount,
    list_plant_effects,
    list_unnamed_effects,
    scale_effect_parameters,
)
from sim.plant.effect_catalogue import convert_stated_size as stated_size
from sim.plant.plant_arm import build_plant_arm
from sim.plant.typical_sizes import read_nominal_drives

# In minimum detectable sizes. One of a pair must not be lost in the other.
MULTIPLES, OF_A_PAIR = (1.0, 3.0, 5.0, 10.0), (3.0, 5.0, 10.0)
# An arm that has ten times as much as any is no arm; where noise is that large, the
# effect stays below the multiple that was asked for.
MOST = 3.0  # of a usual size
Minimum = Sequence[Detectable]


@dataclass(frozen=True, slots=True)
class Hidden:
    """What an arm hides."""

    effect: PlantEffect  # effect, joints and parameters, as the plant takes them
    joints: tuple[int, ...]  # its joints in the convention of the verdict
    size: float | None  # how much of it there is, None where that is no one number
    # The size in minimum detectable ones, None where none is known.
    multiple: float | None
    # That size as a share of the torque of its joint, None where it was not drawn so.
    share: float | None = None


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


def smallest(minimum: Minimum, name: str, joints: Sequence[int]) -> Detectable | None:
    """Return an effect's smallest detectable size, None if no arm has as much."""
    wanted = sorted(joints)
    at = (d for d in minimum if d.name == name and sorted(d.joints) == wanted)
    return next((d for d in at if d.value is not None), None)


def draw_sized(
    robot: Robot,
    rng: np.random.Generator,
    name: str,
    multiple: float | None,
    minimum: Minimum,
) -> PlantEffect:
    """Draw an effect of usual size and place, then make it so many times detectable.

    Where no minimum detectable size is known, or the effect's torque is not in
    proportion to any parameter, the usual size stays.

    Args:
        multiple: Wanted size in minimum detectable ones, None for the usual one.
        minimum: ``minimum_detectable`` of a verdict on the same motion.
    """
    drawn = draw_plant_effect(robot, rng, name)
    values = dict(drawn.parameters)
    usual = compute_effect_amount(name, values)
    least = smallest(minimum, name, number_joints(name, drawn.joints, robot.dof))
    if multiple is None or usual is None or least is None:
        return drawn
    wanted = min(multiple * stated_size(name, float(least.value)), MOST * usual)
    sized = scale_effect_parameters(name, values, wanted / usual)
    return PlantEffect(name, drawn.joints, tuple(sorted(sized.items())))


def measured(
    effect: PlantEffect, minimum: Minimum, robot: Robot, share: float | None = None
) -> Hidden:
    """Return an effect with its size beside the smallest that would be seen."""
    joints = number_joints(effect.name, effect.joints, robot.dof)
    there = compute_effect_amount(effect.name, dict(effect.parameters))
    if not there:
        return Hidden(effect, joints, None, None, share)
    least = smallest(minimum, effect.name, joints)
    multiple = there / stated_size(effect.name, float(least.value)) if least else None
    return Hidden(effect, joints, stated_size(effect.name, there), multiple, share)


def true_parameters(robot: Robot, plant: PlantSpec) -> list[dict[str, float]]:
    """Return the parameters of each hidden effect as a verdict states them.

    Friction and rotors of an arm are scattered about what its maker says. What they
    differ by is no part of the effect that was hidden, but of what is found.
    """
    base, maker = build_plant_arm(robot, plant).base, read_nominal_drives(robot)
    out = []
    for effect in plant.effects:
        values = dict(effect.parameters)
        what = list_plant_effects()[effect.name]
        if what.of_drive:
            there, known = (getattr(x, what.of_drive) for x in (base, maker))
            joint = effect.joints[0] - 1
            values[what.amount[0]] += float(there[joint] - known[joint])
        out.append(values)
    return out
