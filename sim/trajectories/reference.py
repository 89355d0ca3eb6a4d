"""From a specification to the motion that a controller is given."""

from collections.abc import Callable
from functools import partial

import numpy as np

from residual import one_blas_thread
from residual.errors import InputError, check_name
from residual.robot.robot import Robot
from sim.engine.records import Reference, TrajectorySpec, stream
from sim.trajectories.curves import RAMP
from sim.trajectories.excitation import draw, from_coefficients, optimise, sampled
from sim.trajectories.limits import Plan, check, even, workspace
from sim.trajectories.tools import (
    given_places,
    plan_cyclic,
    plan_move_stop_move,
    plan_welding,
)

KINDS = ("fourier", "cyclic", "welding", "move_stop_move")
_GIVEN = ("fourier", "move_stop_move")  # what may be given by its numbers
_SHORTEST = 0.5  # s, of a period
_RATES = (10.0, 20_000.0)  # Hz
_PLANNERS: dict[str, Callable[..., Plan]] = {
    "cyclic": plan_cyclic,
    "welding": plan_welding,
    "move_stop_move": plan_move_stop_move,
}


def make_reference(
    robot: Robot, spec: TrajectorySpec, rate: float, optimised: bool = True
) -> Reference:
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
    return sample(make_plan(robot, spec, optimised), rate)


@one_blas_thread
def make_plan(robot: Robot, spec: TrajectorySpec, optimised: bool = True) -> Plan:
    """Plan a motion and check it; arguments and errors as of `make_reference`."""
    _check_spec(spec)
    rng = stream(spec.seed, f"trajectory/{spec.kind}")
    # One thread: sums in another order would end the search elsewhere.
    if spec.kind == "fourier":
        plan = _fourier(robot, spec, rng, optimised)
    elif spec.coefficients:
        rows = spec.coefficients
        plan = given_places(robot, spec.duration, spec.periods, rows)
    else:
        return _PLANNERS[spec.kind](robot, spec.duration, spec.periods, rng)
    check(robot, plan)
    return plan


@one_blas_thread
def sample(plan: Plan, rate: float) -> Reference:
    """Return the samples of a planned motion at a rate [Hz], both ends included."""
    t = even(plan.duration, rate)
    q, qd, qdd = plan.curve(t)
    return Reference(plan.kind, t, q, qd, qdd, plan.period)


def _fourier(
    robot: Robot, spec: TrajectorySpec, rng: np.random.Generator, optimised: bool
) -> Plan:
    period = spec.duration / spec.periods
    place = workspace(robot, period)
    if spec.coefficients:
        series = from_coefficients(spec.coefficients, robot.dof, period)
    else:
        series = optimise(place, rng) if optimised else draw(place, rng)
    return Plan("fourier", partial(sampled, series), spec.duration, period, period)


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
