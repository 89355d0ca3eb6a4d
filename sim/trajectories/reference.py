"""From a specification to the motion that a controller is given."""

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from residual.errors import InputError
from residual.names import check_name
from residual.recording import Array
from residual.robot.robot import Robot
from residual.threads import one_blas_thread
from sim.engine.geometry import follow
from sim.records import Reference, TrajectorySpec, stream
from sim.trajectories.curves import RAMP, Series, evaluate
from sim.trajectories.excitation import excitation
from sim.trajectories.fourier import (
    Arena,
    arena,
    draw,
    draw_any,
    fit_in,
    room_left,
    sampled,
    shrunk,
)
from sim.trajectories.given import given
from sim.trajectories.limits import LimitError
from sim.trajectories.move_stop_move import plan_move_stop_move
from sim.trajectories.plan import Plan, check, even
from sim.trajectories.problem import Problem, problem
from sim.trajectories.welding import plan_welding
from sim.trajectories.workpiece import Cell, Piece, cell, draw_piece, no_room

_MOST = 8  # strokes to and fro per period
_STROKE = 2.0  # s that one may take where the limits let it
_TURN = 0.07  # share of the third harmonic; 1/9 would be a sharp triangle
_SWING = 0.2  # rad
_NODES = 64  # of a stroke, and of four strokes at least
_SMALLEST = 1e-9  # rad; higher harmonics are left out
_PANELS = 150  # drawn at most
_TOO_FAST = 4  # panels on which one stroke was too fast, before giving up


def plan_cyclic(
    robot: Robot, duration: float, periods: int, rng: np.random.Generator
) -> Plan:
    """Draw a panel and paint it with as many strokes as the limits allow.

    Args:
        duration: Length [s].

    Raises:
        LimitError: If even one stroke per period is too fast.
        InputError: If the arm has too few joints or reaches no panel.
    """
    space, period = cell(robot, "cyclic"), (duration - RAMP) / periods
    too_fast: list[LimitError] = []
    for _ in range(_PANELS):
        piece = draw_piece(space, rng)
        if piece is None:
            continue
        found = _most_strokes(space, piece, period, duration)
        if isinstance(found, Plan):
            return found
        too_fast += [found] if found else []
        if len(too_fast) == _TOO_FAST:
            break
    raise too_fast[0] if too_fast else no_room("cyclic", robot)


def _most_strokes(
    space: Cell, piece: Piece, period: float, duration: float
) -> Plan | LimitError | None:
    """Return the plan of as many strokes as possible, or what is wrong with one."""
    problem = None
    for strokes in range(int(np.clip(period / _STROKE, 1, _MOST)), 0, -1):
        series = _series(space, piece, strokes, period)
        if series is None:
            return problem
        plan = _plan(series, duration)
        try:
            check(space.robot, plan)
            return plan
        except LimitError as error:
            problem = error
    return problem


def _plan(series: Series, duration: float) -> Plan:
    return Plan(
        "cyclic",
        lambda t: evaluate(series, t, duration),
        duration,
        series.period,
        duration,
    )


def _series(space: Cell, piece: Piece, strokes: int, period: float) -> Series | None:
    """Return the joint angles of painting, None where the arm cannot follow."""
    nodes = _NODES * max(strokes, 4)
    angle = 2 * np.pi * np.arange(nodes) / nodes
    targets = [_gun(piece, a, strokes) for a in angle]
    q = follow(space.ways, [*targets, targets[0]], piece.posture, piece.posture)
    # An arm may end in another posture than it began in, or one turn farther.
    if q is None or not space.fits(q) or np.abs(q[-1] - q[0]).max() > 1e-6:
        return None
    waves = np.fft.rfft(q[:-1], axis=0) / nodes
    size = np.abs(waves).max(axis=1)
    last = int(np.flatnonzero(size > _SMALLEST)[-1])
    if last > nodes // 3:
        return None
    waves = waves[: max(last, 1) + 1]
    return Series(waves[0].real, -2 * waves[1:].imag, 2 * waves[1:].real, period)


def _gun(piece: Piece, angle: float, strokes: int):
    """Return the pose of the flange at one point of a period, 0 to 2 pi."""
    own = strokes * angle
    x = (np.sin(own) - _TURN * np.sin(3 * own)) / (1 + _TURN)
    return piece.pose(x, np.cos(angle), _SWING * np.sin(own) * piece.along)


_DRAWN = 40  # random motions to choose the starts from
_STARTS = 2
_STEPS = (50, 120)  # of each start, and of the better one on its way on
_ENOUGH = 1e-5  # change of the cost that ends the search
_ASLEEP = 10.0  # a joint that could move so many times farther hardly moves
_STIRRED = 0.3  # of what it could


def optimise(place: Arena, rng: np.random.Generator) -> Series:
    """Return the best motion that a seeded search from several starts finds.

    Random motions are ranked by cost; sequential quadratic programming improves the
    best few and goes on with the better of them. What comes out is made to keep the
    limits exactly, between samples too.
    """
    search = problem(place)
    drawn = [draw_any(place, rng, anywhere=bool(i % 2)) for i in range(_DRAWN)]
    drawn = [search.point(series) for series in drawn]
    drawn.sort(key=lambda x: search.cost(x)[0])
    points = [_improved(search, x, _STEPS[0]) for x in drawn[:_STARTS]]
    points.sort(key=lambda x: search.cost(x)[0])
    points.append(_improved(search, points[0], _STEPS[1]))
    found = [s for x in points if (s := fit_in(place, search.series(x)))]
    found = [s for series in found if (s := _stirred(place, series))]
    return min(found or [draw(place, rng)], key=lambda series: condition(place, series))


def _stirred(place: Arena, series: Series) -> Series | None:
    """Let joints move that the search has put to sleep.

    The condition number does not mind them, since columns are brought to one length;
    noise does.
    """
    room = room_left(place, series)
    if room.max() < _ASLEEP:
        return series
    return fit_in(place, shrunk(series, np.where(room < _ASLEEP, 1.0, _STIRRED * room)))


def condition(place: Arena, series: Series) -> float:
    """Return the condition number of one period of a motion."""
    t = np.arange(100) / 100 * place.period
    return excitation(place.robot.model, *sampled(series, t)).condition


def _improved(search: Problem, x: Array, steps: int) -> Array:
    bounds = {"type": "ineq", "fun": search.spare, "jac": search.spare_slopes}
    return minimize(
        search.cost,
        x,
        jac=True,
        method="SLSQP",
        constraints=bounds,
        options={"maxiter": steps, "ftol": _ENOUGH},
    ).x


KINDS = ("fourier", "cyclic", "welding", "move_stop_move")

_SHORTEST = 0.5  # s, of a period
_RATES = (10.0, 20_000.0)  # Hz


def make_reference(
    robot: Robot, spec: TrajectorySpec, rate: float, optimised: bool = True
) -> Reference:
    """Plan a motion within the limits of a robot.

    The same specification gives the same motion, whatever the rate; at the same rate
    the same numbers, bit for bit.

    Args:
        spec: What motion. Each family draws from a random stream of its own.
        rate: Samples per second [Hz].
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
        return _plan_fourier(robot, spec, rng, optimised)
    return _PLANNERS[spec.kind](robot, spec.duration, spec.periods, rng)


@one_blas_thread
def sample(plan: Plan, rate: float) -> Reference:
    """Return the samples of a planned motion at a rate [Hz], both ends included."""
    t = even(plan.duration, rate)
    q, qd, qdd = plan.curve(t)
    return Reference(plan.kind, t, q, qd, qdd, plan.period)


_PLANNERS: dict[str, Callable[..., Plan]] = {
    "cyclic": plan_cyclic,
    "welding": plan_welding,
    "move_stop_move": plan_move_stop_move,
}


def _plan_fourier(
    robot: Robot, spec: TrajectorySpec, rng: np.random.Generator, optimised: bool
) -> Plan:
    period = spec.duration / spec.periods
    place = arena(robot, period)
    if spec.coefficients:
        series = given(spec.coefficients, robot.dof, period)
    else:
        series = optimise(place, rng) if optimised else draw(place, rng)
    plan = Plan("fourier", lambda t: sampled(series, t), spec.duration, period, period)
    check(robot, plan)
    return plan


def _check_spec(spec: TrajectorySpec) -> None:
    check_name(spec.kind, KINDS, "trajectory kind")
    if not (np.isfinite(spec.duration) and spec.duration > 0):
        raise InputError(f"duration must be above 0 s, got {spec.duration:g}.")
    if spec.periods < 1:
        raise InputError(f"periods must be 1 or more, got {spec.periods}.")
    if spec.coefficients and spec.kind != "fourier":
        raise InputError(
            f"{spec.kind} has no coefficients; leave them out, or use kind fourier."
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
