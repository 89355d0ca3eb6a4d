"""Hidden effects of a frozen size: a share of the torque of their joint.

No diagnosis has a part in it, so that two of them can be compared on the same cases.
The size is that of `synthetic.visible.share`: rms of the torque that the effect makes
over rms of the joint's torque, where the joint moves, of an arm without noise that is
just as described. What shifts angles counts by the torque of the rigid body at the
angles read.
"""

from collections.abc import Callable, Collection, Sequence

import numpy as np

from benchmarks.changes_parts.sizes import solved
from benchmarks.hidden.draw import MOST
from benchmarks.synthetic.amounts import scale_effect_parameters
from benchmarks.synthetic.visible import Stage, share
from residual.errors import InputError
from residual.robot.robot import Robot
from sim.engine.plant_records import PlantEffect
from sim.plant.effect_catalogue import check_effect, list_plant_effects
from sim.plant.typical_sizes import draw_plant_effect

SHARES = (0.01, 0.02, 0.05, 0.10)  # of the torque of the joint, rms
CLEAR = SHARES[2:]  # what one ought to see
_TRIES = 20


def has_sizes(name: str) -> bool:
    """Whether its torque grows with a parameter; else only usual sizes are drawn."""
    return bool(list_plant_effects()[name].amount)


def draw_of_share(
    robot: Robot,
    rng: np.random.Generator,
    name: str,
    shares: Sequence[float],
    stages: Sequence[Stage],
    avoid: Collection[int] = (),
    written: Callable[[PlantEffect], PlantEffect] = lambda effect: effect,
) -> tuple[PlantEffect, float | None] | None:
    """Draw an effect on a joint where an arm may have the first of some sizes.

    Where no arm has as much, the next size is tried.

    Args:
        shares: Sizes, shares of the torque of the joint.
        stages: The motions on which it has this size.
        avoid: Joints from 1 that are taken.
        written: Makes of the effect what the arm has, a form of another author.

    Returns:
        The effect and its size, None where its torque is in proportion to no parameter
        and the usual size stays. None for no arm that has as much.
    """
    for target in shares:
        for _ in range(_TRIES):
            drawn = draw_plant_effect(robot, rng, name)
            if set(drawn.joints) & set(avoid):
                continue
            if not has_sizes(name):
                return drawn, None

            def size_at(factor: float, drawn: PlantEffect = drawn) -> float | None:
                larger = _scaled(drawn, factor, robot)
                return larger and share(robot, written(larger), stages)

            found = solved(size_at, target)
            sized = found and _scaled(drawn, found[0], robot)
            if sized:
                return sized, target
    return None


def _scaled(drawn: PlantEffect, factor: float, robot: Robot) -> PlantEffect | None:
    """Return a larger effect; None where that is more than any arm has."""
    values = scale_effect_parameters(drawn.name, dict(drawn.parameters), factor)
    larger = PlantEffect(drawn.name, drawn.joints, tuple(sorted(values.items())))
    try:
        check_effect(larger, robot)
    except InputError:
        return None
    return larger if factor <= MOST else None
