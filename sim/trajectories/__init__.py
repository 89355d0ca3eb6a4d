"""Planned motions of an arm: four families within its limits.

From a specification to the motion that a controller is given.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from residual import one_blas_thread
from residual.errors import InputError, check_name
from residual.robot.robot import Robot
from sim.engine.plant_records import ReferenceMotion, TrajectorySpec, create_random_stream
from sim.trajectories.excitation import build_given_series, draw_excitation
from sim.trajectories.planning_limits import (
    RAMP,
    MotionLimitError,
    MotionPlan,
    check_plan,
    space_times_evenly,
)
from sim.trajectories.work_motions import (
    draw_paintings,
    draw_place_routes,
    draw_weldings,
    plan_given_places,
)

_SHORTEST = 0.5  # s, of a period
_RATES = (10.0, 20_000.0)  # Hz


class MotionFamily(NamedTuple):
    """How motions of one kind are found."""

    # (robot, duration, periods, random stream) -> attempts, each a sequence of plans
    # with fewer and fewer moves, so that the first feasible one is the best.
    draw: Callable[..., Iterator[Iterable[MotionPlan]]]
    absent: str  # what was not found, where no attempt has a plan
    # (robot, duration, periods, coefficients) -> the motion that has these numbers;
    # None where something is in its way.
    build: Callable[..., MotionPlan | None] | None = None
    patience: int = 1  # attempts that are too fast even with the fewest moves


_PIECE = (
    "place for a work piece that {} reaches within its ranges, clear of the floor and "
    "itself and away from singular postures"
)
FAMILIES = {
    "fourier": MotionFamily(draw_excitation, "motion of {}", build_given_series),
    "cyclic": MotionFamily(draw_paintings, _PIECE, patience=4),
    "welding": MotionFamily(draw_weldings, _PIECE, patience=3),
    "move_stop_move": MotionFamily(
        draw_place_routes,
        "places that {} can move between within its limits and clear of the floor and itself",
        plan_given_places,
    ),
}
KINDS = tuple(FAMILIES)


def plan_reference_motion(
    robot: Robot, spec: TrajectorySpec, rate: float, optimised: bool = True
) -> ReferenceMotion:
    """Plan a motion within the limits of a robot.

    The same specification gives the same motion, whatever the rate; at the same rate
    the same numbers, bit for bit.

    Args:
        spec: The motion. Each family draws from a separate random stream.
        optimised: Whether a Fourier motion is optimized; else it is drawn, which
            takes no time and excites the parameters a third as well.

    Returns:
        The motion, with both ends: duration * rate + 1 samples, at rest at both ends.

    Raises:
        InputError: If the specification makes no sense, or not for this robot.
        MotionLimitError: If it breaks a limit: which joint, when, and by how much.
    """
    low, high = _RATES
    if not low <= rate <= high:
        raise InputError(f"rate must be {low:g} to {high:g} Hz, got {rate:g}.")
    return sample_plan(plan_motion(robot, spec, optimised), rate)


@one_blas_thread
def plan_motion(robot: Robot, spec: TrajectorySpec, optimised: bool = True) -> MotionPlan:
    """Plan a motion and check it, as `plan_reference_motion` before it is sampled."""
    _check_spec(spec)
    family, errors = FAMILIES[spec.kind], []
    about = (robot, spec.duration, spec.periods)
    # One thread: sums in another order would end the search elsewhere.
    rng = create_random_stream(spec.seed, f"trajectory/{spec.kind}")
    if spec.coefficients:
        plan = family.build(*about, spec.coefficients)
        attempts = [[plan]] if plan else []
    elif spec.kind == "fourier":
        attempts = family.draw(*about, rng, optimised)
    else:
        attempts = family.draw(*about, rng)
    for plans in attempts:
        problem = None
        for plan in plans:
            try:
                check_plan(robot, plan)
                return plan
            except MotionLimitError as error:
                problem = error
        errors += [problem] if problem else []
        if len(errors) == family.patience:
            break
    if errors:
        raise errors[0]
    raise InputError(
        f"{spec.kind}: found no {family.absent.format(robot.name)}. Try another seed, or fourier."
    )


@one_blas_thread
def sample_plan(plan: MotionPlan, rate: float) -> ReferenceMotion:
    """Return the samples of a planned motion at a rate [Hz], both ends included."""
    t = space_times_evenly(plan.duration, rate)
    q, qd, qdd = plan.curve(t)
    return ReferenceMotion(plan.kind, t, q, qd, qdd, plan.period)


def _check_spec(spec: TrajectorySpec) -> None:
    check_name(spec.kind, KINDS, "trajectory kind")
    if not (np.isfinite(spec.duration) and spec.duration > 0):
        raise InputError(f"duration must be above 0 s, got {spec.duration:g}.")
    if spec.periods < 1:
        raise InputError(f"periods must be 1 or more, got {spec.periods}.")
    given = [kind for kind, family in FAMILIES.items() if family.build]
    if spec.coefficients and spec.kind not in given:
        raise InputError(
            f"{spec.kind} has no coefficients; leave them out, or use kind {' or '.join(given)}."
        )
    if spec.seed < 0:
        raise InputError(f"seed must be 0 or more, got {spec.seed}.")
    ramps = 2 * RAMP if spec.kind == "cyclic" else 0.0
    period = spec.duration / spec.periods
    if period < _SHORTEST or spec.duration < ramps:
        least = max(ramps, _SHORTEST * spec.periods)
        raise InputError(
            f"{spec.kind} of {spec.duration:g} s has no room for {spec.periods} "
            f"periods: expected {least:g} s or more. Lengthen the duration."
        )
