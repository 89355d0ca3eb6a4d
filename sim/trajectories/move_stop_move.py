"""Pick and place: quick moves of all joints together, and real dwells between them.

Nothing moves during a dwell: speed is exactly zero, for a gripper to close or open.

A motion may also be given by its places: it stands at the first, and then goes round
all of them, as quickly as the limits allow, so many times.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.errors import InputError
from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.geometry import MARGIN, clearances
from sim.plant.sizes import draw_centre, usual_limits
from sim.trajectories.curves import Motion, dwell, move, move_time, repeated
from sim.trajectories.limits import Plan, Workspace, largest, largest_torque, workspace

_MOST, _LEAST = 40, 2  # places per period
_DWELL = (0.3, 0.9)  # s
_SLOWER = (1.02, 1.4)  # than the limits allow, so that moves differ in speed
_SPREAD = 0.9  # of the usual amplitude
_TRIES = 80  # points drawn for one place
_CENTRES = 20  # postures that routes are drawn about
_LONGER, _STEPS = 1.15, 10  # by which a move that needs too much torque is slowed
_SAMPLES = 60  # of a move
_SPARE = 0.97  # of torque, since it is seen at samples here


@dataclass(frozen=True, eq=False, slots=True)
class _Waypoints:
    """Places [rad], times of the moves to them from the one before, and dwells [s]."""

    places: list[Array]
    times: list[float]
    dwells: list[float]

    @property
    def length(self) -> float:
        """Time it takes, without the way back [s]."""
        return sum(self.times) + sum(self.dwells)


def plan_move_stop_move(
    robot: Robot, duration: float, periods: int, rng: np.random.Generator
) -> Plan:
    """Draw places and visit as many per period as the limits allow.

    Raises:
        LimitError: If even two places per period are too fast.
    """
    space = workspace(robot, duration / periods)
    route = _draw_waypoints(space, rng)
    counts = range(len(route.places), _LEAST - 1, -1)
    plans = (_closed_route(space, route, count, duration) for count in counts)
    found = largest(robot, (plan for plan in plans if plan))
    if isinstance(found, Plan):
        return found
    raise found or _nowhere(robot)


def given_places(
    robot: Robot, duration: float, rounds: int, rows: Sequence[Sequence[float]]
) -> Plan:
    """Return the motion round given places, after a stand that fills the duration.

    Args:
        duration: Length, the stand at the first place included [s].
    """
    shapes = {len(row) for row in rows}
    if len(rows) < _LEAST or shapes != {robot.dof}:
        raise InputError(
            f"coefficients of move_stop_move: expected {_LEAST} or more places of "
            f"{robot.dof} angles, got {len(rows)} of {sorted(shapes)}."
        )
    places = np.array(rows, dtype=float)
    if not np.isfinite(places).all():
        raise InputError("coefficients: expected finite numbers.")
    space, times = workspace(robot, duration), []
    for start, end in zip(places, np.roll(places, -1, axis=0), strict=True):
        time = _move_time(space, start, end)
        if time is None:
            raise _nowhere(robot)
        times.append(_SLOWER[0] * time)
    stand = duration - rounds * sum(times)
    if stand < 0:
        raise InputError(
            f"move_stop_move: {rounds} rounds of {sum(times):.2f} s do not fit into "
            f"{duration:g} s. Lengthen the duration, or ask for fewer periods."
        )
    ways = zip(places, np.roll(places, -1, axis=0), times, strict=True)
    going = repeated([move(start, end, time) for start, end, time in ways])

    def curve(t: Array) -> Motion:
        return going(np.clip(t - stand, 0.0, None))

    once = min(stand + sum(times), duration)
    return Plan("move_stop_move", curve, duration, sum(times), once)


def _draw_waypoints(space: Workspace, rng: np.random.Generator) -> _Waypoints:
    """Draw more places than fit into a period, but two at least."""
    space_used = usual_limits(space.robot)
    for number in range(_CENTRES):
        centre = draw_centre(space_used, rng)
        if number:  # the zero posture of some arms lies on the floor
            limits = space.limits
            centre = limits.middle + rng.uniform(-0.6, 0.6, len(centre)) * limits.half
        route = _around(space, centre, space_used.amplitude, rng)
        if len(route.places) >= _LEAST:
            return route
    raise _nowhere(space.robot)


def _around(
    space: Workspace, centre: Array, amplitude: Array, rng: np.random.Generator
) -> _Waypoints:
    """Draw a route about a posture; it is shorter where the next place is not found."""
    route, limits = _Waypoints([], [], []), space.limits
    while len(route.places) < _LEAST or (
        len(route.places) < _MOST and route.length < space.period
    ):
        for _ in range(_TRIES):
            reach = rng.uniform(-_SPREAD, _SPREAD, space.robot.dof)
            place = centre + reach * amplitude
            place = np.clip(place, limits.lower, limits.upper)
            time = _move_time(space, route.places[-1] if route.places else place, place)
            if time is not None:
                break
        else:
            return route
        if route.places:
            route.times.append(time * rng.uniform(*_SLOWER))
        route.places.append(place)
        route.dwells.append(rng.uniform(*_DWELL))
    return route


def _move_time(space: Workspace, start: Array, end: Array) -> float | None:
    """Return the shortest time of a move [s], None where something is in the way."""
    limits = space.limits
    time = move_time(end - start, limits.velocity, limits.acceleration)
    for _ in range(_STEPS):
        motion = move(start, end, time).motion(np.linspace(0, time, _SAMPLES))
        if (clearances(space.arm, motion[0]) < 2 * MARGIN).any():
            return None
        if (largest_torque(space.robot, *motion) <= _SPARE * limits.torque).all():
            return time
        time *= _LONGER
    return None


def _closed_route(
    space: Workspace, route: _Waypoints, count: int, duration: float
) -> Plan | None:
    """Return the route of the first places and back, None where it does not fit.

    It is stretched to fill the period. Two places are pressed into any period: then the
    checks say what is too fast.
    """
    period = space.period
    back = _move_time(space, route.places[count - 1], route.places[0])
    if back is None:
        return None
    moves = [*route.times[: count - 1], _SLOWER[0] * back]
    needed = sum(moves) + sum(route.dwells[:count])
    if needed > period and count > _LEAST:
        return None
    stages, places = [], [*route.places[:count], route.places[0]]
    for i in range(count):
        stages.append(dwell(places[i], route.dwells[i] * period / needed))
        stages.append(move(places[i], places[i + 1], moves[i] * period / needed))
    return Plan("move_stop_move", repeated(stages), duration, period, period)


def _nowhere(robot: Robot) -> InputError:
    return InputError(
        f"move_stop_move: found no places that {robot.name} can move between within "
        "its limits and clear of the floor and itself. Try another seed, or fourier."
    )
