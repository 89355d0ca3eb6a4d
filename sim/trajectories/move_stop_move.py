"""Pick and place: quick moves of all joints together, and real dwells between them.

Nothing moves during a dwell: speed is exactly zero, for a gripper to close or open.
"""

from dataclasses import dataclass

import numpy as np

from residual.errors import InputError
from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.geometry import MARGIN, Body, body, clearances
from sim.sizes import Room, draw_centre, room
from sim.trajectories.curves import dwell, move, move_time, repeated
from sim.trajectories.limits import LimitError, Limits, largest_torque, plan_limits
from sim.trajectories.plan import Plan, check

_MOST, _LEAST = 40, 2  # places per period
_DWELL = (0.3, 0.9)  # s
_SLOWER = (1.02, 1.4)  # than the limits allow, so that moves differ in speed
_SPREAD = 0.9  # of the amplitude in the room of the robot
_TRIES = 80  # points drawn for one place
_CENTRES = 20  # postures that tours are drawn about
_LONGER, _STEPS = 1.15, 10  # by which a move that needs too much torque is slowed
_SAMPLES = 60  # of a move
_SPARE = 0.97  # of torque, since it is seen at samples here


@dataclass(frozen=True, eq=False, slots=True)
class _Yard:
    """An arm with all that bounds its moves."""

    robot: Robot
    space: Room
    limits: Limits
    arm: Body


@dataclass(frozen=True, eq=False, slots=True)
class _Tour:
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

    Args:
        duration: Length [s].

    Raises:
        LimitError: If even two places per period are too fast.
        InputError: If the arm cannot move anywhere without touching something.
    """
    yard = _Yard(robot, room(robot), plan_limits(robot), body(robot.model))
    period = duration / periods
    tour, problem = _draw_tour(yard, period, rng), _nowhere(robot)
    for count in range(len(tour.places), _LEAST - 1, -1):
        plan = _closed(yard, tour, count, (duration, period))
        if plan is None:
            continue
        try:
            check(robot, plan)
            return plan
        except LimitError as error:
            problem = error
    raise problem


def _draw_tour(yard: _Yard, period: float, rng: np.random.Generator) -> _Tour:
    """Draw more places than fit into a period, but two at least."""
    for number in range(_CENTRES):
        centre = draw_centre(yard.space, rng)
        if number:  # the zero posture of some arms lies on the floor
            limits = yard.limits
            centre = limits.middle + rng.uniform(-0.6, 0.6, len(centre)) * limits.half
        tour = _around(yard, centre, period, rng)
        if len(tour.places) >= _LEAST:
            return tour
    raise _nowhere(yard.robot)


def _around(
    yard: _Yard, centre: Array, period: float, rng: np.random.Generator
) -> _Tour:
    """Draw a tour about a posture; it is shorter where the next place is not found."""
    tour, limits = _Tour([], [], []), yard.limits
    while len(tour.places) < _LEAST or (
        len(tour.places) < _MOST and tour.length < period
    ):
        for _ in range(_TRIES):
            reach = rng.uniform(-_SPREAD, _SPREAD, yard.robot.dof)
            place = centre + reach * yard.space.amplitude
            place = np.clip(place, limits.lower, limits.upper)
            time = _move_time(yard, tour.places[-1] if tour.places else place, place)
            if time is not None:
                break
        else:
            return tour
        if tour.places:
            tour.times.append(time * rng.uniform(*_SLOWER))
        tour.places.append(place)
        tour.dwells.append(rng.uniform(*_DWELL))
    return tour


def _move_time(yard: _Yard, start: Array, end: Array) -> float | None:
    """Return the shortest time of a move [s], None where something is in the way."""
    limits = yard.limits
    time = move_time(end - start, limits.velocity, limits.acceleration)
    for _ in range(_STEPS):
        motion = move(start, end, time).motion(np.linspace(0, time, _SAMPLES))
        if (clearances(yard.arm, motion[0]) < 2 * MARGIN).any():
            return None
        if (largest_torque(yard.robot, *motion) <= _SPARE * limits.torque).all():
            return time
        time *= _LONGER
    return None


def _closed(yard: _Yard, tour: _Tour, count: int, times: tuple) -> Plan | None:
    """Return the tour of the first places and back, None where it does not fit.

    It is stretched to fill the period. Two places are pressed into any period: then the
    checks say what is too fast.
    """
    duration, period = times
    back = _move_time(yard, tour.places[count - 1], tour.places[0])
    if back is None:
        return None
    moves = [*tour.times[: count - 1], _SLOWER[0] * back]
    needed = sum(moves) + sum(tour.dwells[:count])
    if needed > period and count > _LEAST:
        return None
    stages, places = [], [*tour.places[:count], tour.places[0]]
    for i in range(count):
        stages.append(dwell(places[i], tour.dwells[i] * period / needed))
        stages.append(move(places[i], places[i + 1], moves[i] * period / needed))
    return Plan("move_stop_move", repeated(stages), duration, period, period)


def _nowhere(robot: Robot) -> InputError:
    return InputError(
        f"move_stop_move: found no places that {robot.name} can move between within "
        "its limits and clear of the floor and itself. Try another seed, or fourier."
    )
