"""From a specification to the motion that a controller is given."""

from collections.abc import Callable
from functools import partial

import numpy as np

from residual import one_blas_thread
from residual.errors import InputError, check_name
from residual.robot.robot import Robot
from sim.engine.plant_records import (
    ReferenceMotion,
    TrajectorySpec,
    create_random_stream,
)
from sim.trajectories.excitation import (
    build_coefficient_series,
    draw_feasible_series,
    optimize_excitation,
    sample_series,
)
from sim.trajectories.motion_curves import RAMP
from sim.trajectories.planning_limits import (
    MotionPlan,
    build_workspace,
    check_plan,
    space_times_evenly,
)
from sim.trajectories.work_motions import (
    plan_cyclic,
    plan_given_places,
    plan_move_stop_move,
    plan_welding,
)

KINDS = ("fourier", "cyclic", "welding", "move_stop_move")
_GIVEN = ("fourier", "move_stop_move")  # what may be given by its numbers
_SHORTEST = 0.5  # s, of a period
_RATES = (10.0, 20_000.0)  # Hz
_PLANNERS: dict[str, Callable[..., MotionPlan]] = {
    "cyclic": plan_cyclic,
    "welding": plan_welding,
    "move_stop_move": plan_move_stop_move,
}


def plan_reference_motion(
    robot: Robot, spec: TrajectorySpec, rate: float, optimised: bool = True
) -> ReferenceMotion:
    """Plan a motion within the limits of a robot.

    The same specification gives the same motion, whatever the rate; at the same rate
    the same numbers, bit for bit.

    Args:
        spec: What motion. Each family draws from a random stream of its own.
        optimised: Whether a Fourier motion is searched for; else it is drawn, which
            takes no time and excites the parameters a third as well.

    Returns:
        The motion, with both ends: duration * rate + 1 samples, at rest at both ends.

    Raises:
        InputError: If the specification makes no sense, or not for this robot.
        LimitError: If it breaks a limit: which joint, when, and by how much.
    """
    low, high = _RATES
    if not low <= rate <= high:
        raise InputError(f"rate must be {low:g} to {high:g} Hz, got {rate:g}.")
    return sample_plan(plan_motion(robot, spec, optimised), rate)


@one_blas_thread
def plan_motion(
    robot: Robot, spec: TrajectorySpec, optimised: bool = True
) -> MotionPlan:
    """Plan a motion and check it, as `plan_reference_motion` before it is sampled."""
    _check_spec(spec)
    rng = create_random_stream(spec.seed, f"trajectory/{spec.kind}")
    # One thread: sums in another order would end the search elsewhere.
    if spec.kind == "fourier":
        plan = _fourier(robot, spec, rng, optimised)
    elif spec.coefficients:
        rows = spec.coefficients
        plan = plan_given_places(robot, spec.duration, spec.periods, rows)
    else:
        return _PLANNERS[spec.kind](robot, spec.duration, spec.periods, rng)
    check_plan(robot, plan)
    return plan


@one_blas_thread
def sample_plan(plan: MotionPlan, rate: float) -> ReferenceMotion:
    """Return the samples of a planned motion at a rate [Hz], both ends included."""
    t = space_times_evenly(plan.duration, rate)
    q, qd, qdd = plan.curve(t)
    return ReferenceMotion(plan.kind, t, q, qd, qdd, plan.period)


def _fourier(
    robot: Robot, spec: TrajectorySpec, rng: np.random.Generator, optimised: bool
) -> MotionPlan:
    period = spec.duration / spec.periods
    place = build_workspace(robot, period)
    if spec.coefficients:
        series = build_coefficient_series(spec.coefficients, robot.dof, period)
    else:
        series = (
            optimize_excitation(place, rng)
            if optimised
            else draw_feasible_series(place, rng)
        )
    return MotionPlan(
        "fourier", partial(sample_series, series), spec.duration, period, period
    )


def _check_spec(spec: TrajectorySpec) -> None:
    check_name(spec.kind, KINDS, "trajectory kind")
    if not (np.isfinite(spec.duration) and spec.duration > 0):
        raise InputError(f"duration must be above 0 s, got {spec.duration:g}.")
    if spec.periods < 1:
        raise InputError(f"periods must be 1 or more, got {spec.periods}.")
    if spec.coefficients and spec.kind not in _GIVEN:
        raise InputError(
            f"{spec.kind} has no coefficients; leave them out, or use kind "
            f"{' or '.join(_GIVEN)}."
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
