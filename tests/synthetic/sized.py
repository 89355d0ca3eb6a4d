"""Hidden effects of a frozen size: a share of the torque of their joint.

No diagnosis has a part in it, so that two of them can be compared on the same cases.
The size is that of `synthetic.visible.share`: rms of the torque that the effect makes
over rms of the joint's torque, where the joint moves, of an arm without noise that is
just as described. What shifts angles counts by the torque of the rigid body at the
angles read.
"""

from collections.abc import Callable, Collection, Sequence
from functools import partial

import numpy as np

from residual.errors import InputError
from residual.robot.robot import Robot
from sim.engine.plant_records import PlantEffect
from sim.plant.effect_catalogue import check_effect, list_plant_effects
from sim.plant.typical_sizes import draw_plant_effect
from tests.synthetic.amounts import scale_effect
from tests.synthetic.draws import MOST
from tests.synthetic.visible import Stage, share

SHARES = (0.01, 0.02, 0.05, 0.10)  # of the torque of the joint, rms
CLEAR = SHARES[2:]  # what one ought to see
_DRAWS = 20
_CLOSE, _TRIES = 0.01, 6  # of the size asked for; simulations
_STEEP = (0.3, 3.0)  # by what power a size may follow the parameter


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
        for _ in range(_DRAWS):
            drawn = draw_plant_effect(robot, rng, name)
            if set(drawn.joints) & set(avoid):
                continue
            if not has_sizes(name):
                return drawn, None

            larger = partial(scale_effect, drawn)
            sized = solve_size(robot, larger, target, stages, MOST, written)
            if sized:
                return sized[0], target
    return None


def solve_size(
    robot: Robot,
    larger: Callable[[float], PlantEffect],
    target: float,
    stages: Sequence[Stage],
    most: float,
    written: Callable[[PlantEffect], PlantEffect] = lambda effect: effect,
) -> tuple[PlantEffect, float] | None:
    """Return an effect of a size, and that size; None where no arm has as much.

    Args:
        larger: Makes the effect a factor larger, which is `most` at most.
    """

    def size_at(factor: float) -> float | None:
        try:
            check_effect(larger(factor), robot)
        except InputError:
            return None
        return None if factor > most else share(robot, written(larger(factor)), stages)

    solution = solved(size_at, target)
    return solution and (larger(solution[0]), solution[1])


def solved(size_at: Callable[[float], float | None], target: float) -> tuple[float, float] | None:
    """Return what times a change has a size, and that size; None for never."""
    before: tuple[float, float] | None = None
    factor = 1.0
    for _ in range(_TRIES):
        size = size_at(factor)
        if size is None or not 0 < size < np.inf:
            return None
        miss = float(np.log(target / size))
        if abs(miss) <= _CLOSE:
            return factor, size
        power = 1.0
        if before is not None and abs(step := np.log(factor) - before[0]) > 1e-9:
            power = float(np.clip((np.log(size) - before[1]) / step, *_STEEP))
        before = float(np.log(factor)), float(np.log(size))
        factor *= float(np.exp(miss / power))
    return None
