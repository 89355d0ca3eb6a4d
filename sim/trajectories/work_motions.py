"""Motions at work: pick and place, painting a panel and welding seams.

Pick and place: quick moves of all joints together, and real dwells between them, in
which speed is exactly zero, for a gripper to close or open. It may also be given by its
places: it dwells at the first, and then visits all of them in turn, as quickly as the
limits allow, a number of times.

A work piece is a plane in front of the arm. Painting (cyclic) goes back and forth over
it; welding follows straight seams at constant speed, with air moves between them: of the
same kind as pick and place, with more segments (G2017 section 2.1), since the arm stops
where a seam begins and ends. Seams and air moves are paths of poses; the joint
angles along each are a polynomial through its nodes, exact to rounding.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.geometry import (
    MARGIN,
    NEAR_SINGULAR,
    ToolKinematics,
    build_arm_capsules,
    build_tool_kinematics,
    compute_clearances,
    compute_flange_pose,
    measure_singularity_distance,
    solve_inverse_kinematics,
    solve_pose_path,
)
from sim.plant.typical_sizes import compute_usual_motion_range, draw_motion_centre
from sim.trajectories.planning_limits import (
    RAMP,
    FourierSeries,
    JointPath,
    Motion,
    MotionPlan,
    MotionStage,
    MotionWorkspace,
    PlanningLimits,
    bound_nominal_torque,
    build_dwell,
    build_joint_move,
    build_path_stage,
    build_workspace,
    compute_path_nodes,
    evaluate_ramped_series,
    find_shortest_move_time,
    find_shortest_stage_time,
    interpolate_joint_path,
    read_planning_limits,
    repeat_stages,
)

_MOST_PLACES, _LEAST_PLACES = 40, 2  # places per period
_DWELLS = (0.3, 0.9)  # s
_SLOWER = (1.02, 1.4)  # than the limits allow, so that moves differ in speed
_PLACE_SPREAD = 0.9  # of the usual amplitude
_TRIES = 80  # points drawn for one place
_CENTRES = 20  # postures around which routes are drawn
_LONGER, _TRIALS = 1.15, 10  # by which a move of too much torque is slowed
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


def draw_place_routes(
    robot: Robot, duration: float, periods: int, rng: np.random.Generator
) -> Iterator[Iterable[MotionPlan]]:
    """Draw places once; plans visit fewer and fewer of them per period."""
    space = build_workspace(robot, duration / periods)
    if route := _draw_waypoints(space, rng):
        counts = range(len(route.places), _LEAST_PLACES - 1, -1)
        plans = (_closed_route(space, route, count, duration) for count in counts)
        yield filter(None, plans)


def plan_given_places(
    robot: Robot, duration: float, rounds: int, postures: Sequence[Sequence[float]]
) -> MotionPlan | None:
    """Return the motion through given places, after a dwell that fills the duration.

    Args:
        duration: Length, the stand at the first place included [s].

    Returns:
        The plan; None if a move is blocked.
    """
    shapes = {len(row) for row in postures}
    if len(postures) < _LEAST_PLACES or shapes != {robot.dof}:
        raise InputError(
            f"coefficients of move_stop_move: expected {_LEAST_PLACES} or more places "
            f"of {robot.dof} angles, got {len(postures)} of {sorted(shapes)}."
        )
    places = np.array(postures, dtype=float)
    if not np.isfinite(places).all():
        raise InputError("coefficients: expected finite numbers.")
    space, times = build_workspace(robot, duration), []
    for start, end in zip(places, np.roll(places, -1, axis=0), strict=True):
        time = _move_time(space, start, end)
        if time is None:
            return None
        times.append(_SLOWER[0] * time)
    stand = duration - rounds * sum(times)
    if stand < 0:
        raise InputError(
            f"move_stop_move: {rounds} rounds of {sum(times):.2f} s do not fit into "
            f"{duration:g} s. Lengthen the duration, or ask for fewer periods."
        )
    ways = zip(places, np.roll(places, -1, axis=0), times, strict=True)
    going = repeat_stages([build_joint_move(start, end, time) for start, end, time in ways])

    def curve(t: Array) -> Motion:
        return going(np.clip(t - stand, 0.0, None))

    once = min(stand + sum(times), duration)
    return MotionPlan("move_stop_move", curve, duration, sum(times), once)


def _draw_waypoints(space: MotionWorkspace, rng: np.random.Generator) -> _Waypoints | None:
    """Draw more places than fit into a period, but two at least; None for fewer."""
    space_used = compute_usual_motion_range(space.robot)
    for number in range(_CENTRES):
        centre = draw_motion_centre(space_used, rng)
        if number:  # the zero posture of some arms lies on the floor
            limits = space.limits
            centre = limits.middle + rng.uniform(-0.6, 0.6, len(centre)) * limits.half
        route = _around(space, centre, space_used.amplitude, rng)
        if len(route.places) >= _LEAST_PLACES:
            return route
    return None


def _around(
    space: MotionWorkspace, centre: Array, amplitude: Array, rng: np.random.Generator
) -> _Waypoints:
    """Draw a route about a posture; it is shorter where the next place is not found."""
    route, limits = _Waypoints([], [], []), space.limits
    while len(route.places) < _LEAST_PLACES or (
        len(route.places) < _MOST_PLACES and route.length < space.period
    ):
        for _ in range(_TRIES):
            reach = rng.uniform(-_PLACE_SPREAD, _PLACE_SPREAD, space.robot.dof)
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
        route.dwells.append(rng.uniform(*_DWELLS))
    return route


def _move_time(space: MotionWorkspace, start: Array, end: Array) -> float | None:
    """Return the shortest time of a move [s], None if it is blocked."""
    limits = space.limits
    time = find_shortest_move_time(end - start, limits.velocity, limits.acceleration)
    for _ in range(_TRIALS):
        move = build_joint_move(start, end, time).motion(np.linspace(0, time, _SAMPLES))
        if (compute_clearances(space.arm, move[0]) < 2 * MARGIN).any():
            return None
        if (bound_nominal_torque(space.robot, *move) <= _SPARE * limits.torque).all():
            return time
        time *= _LONGER
    return None


def _closed_route(
    space: MotionWorkspace, route: _Waypoints, count: int, duration: float
) -> MotionPlan | None:
    """Return the route of the first places and back, None where it does not fit.

    It is stretched to fill the period. Two places are squeezed into any period: then
    the checks report what is too fast.
    """
    period = space.period
    back = _move_time(space, route.places[count - 1], route.places[0])
    if back is None:
        return None
    moves = [*route.times[: count - 1], _SLOWER[0] * back]
    needed = sum(moves) + sum(route.dwells[:count])
    if needed > period and count > _LEAST_PLACES:
        return None
    stages, places = [], [*route.places[:count], route.places[0]]
    for i in range(count):
        stages.append(build_dwell(places[i], route.dwells[i] * period / needed))
        stages.append(build_joint_move(places[i], places[i + 1], moves[i] * period / needed))
    return MotionPlan("move_stop_move", repeat_stages(stages), duration, period, period)


_PIECES = 150  # work pieces drawn at most
_GUESSES = 6  # postures of the arm to try
# Ranges that a work piece is drawn from; lengths as shares of the stretched arm.
_ASIDE = (-0.4, 0.4)  # rad
_AWAY, _HIGH = (0.35, 0.6), (0.15, 0.6)
_DOWN = (0.35, 1.4)  # rad that the tool points below the horizon
_SIDEWAYS = (-0.6, 0.6)  # rad that it points away from straight ahead
_WIDE, _TALL = (0.10, 0.18), (0.05, 0.10)  # half sizes
# Painting.
_STROKES = 8  # strokes to and fro per period at most
_STROKE = 2.0  # s that one may take where the limits let it
_TURN = 0.07  # share of the third harmonic; 1/9 would be a sharp triangle
_SWING = 0.2  # rad
_STROKE_NODES = 64  # of a stroke, and of four strokes at least
_SMALLEST = 1e-9  # rad; higher harmonics are left out
# Welding.
_MOST, _LEAST = 8, 2  # seams per period
_NODES = 33  # of a path
_DWELL = 0.2  # s, for the arc to start and the crater to fill
_EASE = 1.15  # factor over the shortest time
_AIR, _SEAM = 0.4, 0.8  # s, least times
_LEAN = 0.3  # rad by which a torch leans at most
_LIFT = 0.06  # of the stretched arm, above the piece between seams
_LENGTH = 0.7  # least length of a seam, in half widths of the piece


@dataclass(frozen=True, eq=False, slots=True)
class ToolWorkspace(MotionWorkspace):
    """An arm with all limits of a path of its tool."""

    ways: ToolKinematics

    def fits(self, q: Array) -> bool:
        """Return whether postures are in range, clear of collisions and not near singular."""
        inside = (q >= self.limits.lower) & (q <= self.limits.upper)
        return bool(
            inside.all()
            and measure_singularity_distance(self.ways, q).min() > NEAR_SINGULAR
            and (compute_clearances(self.arm, q) >= MARGIN).all()
        )


def build_tool_workspace(robot: Robot, family: str, period: float) -> ToolWorkspace:
    """Return the cell of a robot; the error of `build_tool_kinematics` for a short arm."""
    limits, arm = read_planning_limits(robot), build_arm_capsules(robot.model)
    return ToolWorkspace(robot, limits, arm, period, build_tool_kinematics(robot, family))


@dataclass(frozen=True, eq=False, slots=True)
class WorkPiece:
    """A plane to work on."""

    origin: pin.SE3  # pose of the flange over its middle
    across: Array  # level direction in the plane, (3,)
    along: Array  # direction in the plane that is square to it, (3,)
    half: Array  # half sizes across and along [m], (2,)
    posture: Array  # joint angles with the tool in the middle [rad], (dof,)

    def pose(self, x: float, y: float, turn: Array, lift: float = 0.0) -> pin.SE3:
        """Return the pose of the flange over a point.

        Args:
            x: Place across, from -1 to 1.
            y: Place along, from -1 to 1.
            turn: Rotation away from the upright tool, a vector in the base frame
                [rad]. Shape (3,).
            lift: Height above the plane [m].
        """
        off = np.cross(self.across, self.along)
        place = self.origin.translation + x * self.half[0] * self.across
        place = place + y * self.half[1] * self.along + lift * off
        return pin.SE3(pin.exp3(turn) @ self.origin.rotation, place)


# Spray painting: repeated strokes back and forth over a panel, normal to it.
#
# The gun crosses the panel at constant speed, turns smoothly outside it, moves down and
# up again, and swings out a little at the end of each stroke. The path is closed and
# smooth, so the joint angles along it are a Fourier series, exact to rounding.


def draw_paintings(
    robot: Robot, duration: float, periods: int, rng: np.random.Generator
) -> Iterator[Iterable[MotionPlan]]:
    """Draw panels; plans paint each with fewer and fewer strokes."""
    space = build_tool_workspace(robot, "cyclic", (duration - RAMP) / periods)
    for piece in _draw_pieces(space, rng):
        yield _paintings(space, piece, duration)


def draw_weldings(
    robot: Robot, duration: float, periods: int, rng: np.random.Generator
) -> Iterator[Iterable[MotionPlan]]:
    """Draw work pieces; plans weld fewer and fewer seams of each per period."""
    space = build_tool_workspace(robot, "welding", duration / periods)
    for piece in _draw_pieces(space, rng):
        seams = [_draw_seam(piece, rng) for _ in range(_MOST)]
        if _routes(space, piece, seams) is not None:
            yield _weldings(space, piece, seams, duration)


def _draw_pieces(space: ToolWorkspace, rng: np.random.Generator) -> Iterator["WorkPiece"]:
    drawn = (draw_work_piece(space, rng) for _ in range(_PIECES))
    return filter(None, drawn)


def _paintings(space: ToolWorkspace, piece: WorkPiece, duration: float) -> Iterator[MotionPlan]:
    """Return plans of fewer and fewer strokes, as far as the arm can follow."""
    period = space.period
    for strokes in range(int(np.clip(period / _STROKE, 1, _STROKES)), 0, -1):
        series = _series(space, piece, strokes)
        if series is None:
            return
        curve = partial(evaluate_ramped_series, series, duration=duration)
        yield MotionPlan("cyclic", curve, duration, period, duration)


def _weldings(
    space: ToolWorkspace, piece: WorkPiece, seams: list, duration: float
) -> Iterator[MotionPlan]:
    """Return plans of fewer and fewer seams, where the arm can follow them."""
    period = space.period
    for count in range(_MOST, _LEAST - 1, -1):
        routes = _routes(space, piece, seams[:count])
        stages = routes and _timed(space.limits, routes, period, count == _LEAST)
        if stages:
            yield MotionPlan("welding", repeat_stages(stages), duration, period, period)


def draw_work_piece(cell: ToolWorkspace, rng: np.random.Generator) -> WorkPiece | None:
    """Draw a work piece in front of the arm; None where the arm cannot work on it."""
    ways = cell.ways
    # From the direction in which the arm points at its zero posture.
    x, y, _ = compute_flange_pose(ways, pin.neutral(ways.model)).translation
    front = 0.0 if np.hypot(x, y) < 0.05 * ways.length else float(np.arctan2(y, x))
    angle = front + rng.uniform(*_ASIDE)
    away, high = (ways.length * rng.uniform(*share) for share in (_AWAY, _HIGH))
    down, roll = rng.uniform(*_DOWN), rng.uniform(0, 2 * np.pi)
    half = ways.length * np.array([rng.uniform(*_WIDE), rng.uniform(*_TALL)])
    ahead = angle + rng.uniform(*_SIDEWAYS)
    across = np.array([-np.sin(ahead), np.cos(ahead), 0.0])
    tool = np.array([np.cos(ahead), np.sin(ahead), -np.tan(down)]) * np.cos(down)
    place = np.array([away * np.cos(angle), away * np.sin(angle), high])
    turn = pin.Quaternion.FromTwoVectors(ways.tool, tool).toRotationMatrix()
    rotation = turn @ pin.exp3(roll * ways.tool)
    posture = _best_posture(cell, pin.SE3(rotation, place), rng)
    if posture is None:
        return None
    # across x along points back along the tool, so that a lift leaves the piece.
    along = np.cross(across, tool)
    return WorkPiece(pin.SE3(rotation, place), across, along, half, posture)


def _best_posture(space: ToolWorkspace, target: pin.SE3, rng: np.random.Generator) -> Array | None:
    """Return the posture for a pose that is farthest from singular ones. (dof,)."""
    limits, postures, room = space.limits, [], compute_usual_motion_range(space.robot)
    for share in rng.uniform(-1, 1, (_GUESSES, space.robot.dof)):
        guess = room.centre + share * room.amplitude
        q = solve_inverse_kinematics(space.ways, target, guess)
        if q is None:
            continue
        # Angles modulo a turn are the same posture; the one nearest mid-range has most room.
        q = q - 2 * np.pi * np.round((q - limits.middle) / (2 * np.pi))
        if space.fits(q[None]):
            postures.append(q)
    free = [float(measure_singularity_distance(space.ways, q[None])[0]) for q in postures]
    return postures[int(np.argmax(free))] if postures else None


def _series(space: ToolWorkspace, piece: WorkPiece, strokes: int) -> FourierSeries | None:
    """Return the joint angles of painting, None where the arm cannot follow."""
    count = _STROKE_NODES * max(strokes, 4)
    angle = 2 * np.pi * np.arange(count) / count
    targets = [_gun(piece, a, strokes) for a in angle]
    q = solve_pose_path(space.ways, [*targets, targets[0]], piece.posture, piece.posture)
    # An arm may end in another posture than it began in, or one turn farther.
    if q is None or not space.fits(q) or np.abs(q[-1] - q[0]).max() > 1e-6:
        return None
    w = np.fft.rfft(q[:-1], axis=0) / count
    size = np.abs(w).max(axis=1)
    last = int(np.flatnonzero(size > _SMALLEST)[-1])
    if last > count // 3:
        return None
    w = w[: max(last, 1) + 1]
    return FourierSeries(w[0].real, -2 * w[1:].imag, 2 * w[1:].real, space.period)


def _gun(piece: WorkPiece, angle: float, strokes: int):
    """Return the pose of the flange at one point of a period, 0 to 2 pi."""
    own = strokes * angle
    x = (np.sin(own) - _TURN * np.sin(3 * own)) / (1 + _TURN)
    return piece.pose(x, np.cos(angle), _SWING * np.sin(own) * piece.along)


# Joint angles along a seam, and along the air move that follows it; the last air move
# leads back to the first seam.
_Route = tuple[JointPath, JointPath]


def _draw_seam(piece: WorkPiece, rng: np.random.Generator) -> Array:
    """Draw both ends: place on the piece, -1 to 1, and lean [rad]. Shape (2, 5)."""
    axes = np.array([piece.across, piece.along, np.cross(piece.across, piece.along)])
    lean = rng.uniform(-_LEAN, _LEAN, 3) @ axes
    ends = rng.uniform(-1, 1, (2, 2))
    while np.linalg.norm((ends[1] - ends[0]) * piece.half) < _LENGTH * piece.half[0]:
        ends = rng.uniform(-1, 1, (2, 2))
    return np.hstack([ends, [lean, lean]])


def _routes(space: ToolWorkspace, piece: WorkPiece, seams: list) -> list[_Route] | None:
    """Return the joint angles along all paths, None where the arm cannot follow."""
    lift, found = _LIFT * space.ways.length, []
    last = piece.posture
    for (start, end), (after, _) in zip(seams, [*seams[1:], seams[0]], strict=True):
        for points, height in (((start, end), 0.0), ((end, after), lift)):
            targets = [_torch(piece, *points, height, x) for x in compute_path_nodes(_NODES)]
            q = solve_pose_path(space.ways, targets, last, piece.posture)
            if q is None or not space.fits(q):
                return None
            found.append(q)
            last = q[-1]
    if np.abs(found[-1][-1] - found[0][0]).max() > 1e-6:
        return None  # back over the first seam in another posture
    paths = [interpolate_joint_path(q) for q in found]
    return list(zip(paths[::2], paths[1::2], strict=True))


def _torch(piece: WorkPiece, start: Array, end: Array, height: float, x: float) -> pin.SE3:
    """Return the pose of the flange on the way between two ends, x from 0 to 1."""
    at = start + x * (end - start)
    return piece.pose(at[0], at[1], at[2:], height * 16 * x**2 * (1 - x) ** 2)


def _timed(
    limits: PlanningLimits, routes: list[_Route], period: float, hurry: bool
) -> list[MotionStage] | None:
    """Return the stages of one period; the remaining time goes to the seams.

    Returns:
        The stages; None where the period is too short, unless in a hurry: then all
        stages are fast enough to fit.
    """
    bounds = (limits.velocity, limits.acceleration)
    stages = ([build_path_stage(s, 1.0, True), build_path_stage(a, 1.0, False)] for s, a in routes)
    least = [[find_shortest_stage_time(stage, *bounds) for stage in pair] for pair in stages]
    seams, moves = np.array(least).T
    seams = np.maximum(_EASE * seams, _SEAM)
    moves, still = np.maximum(_EASE * moves, _AIR), _DWELL
    needed = seams.sum() + moves.sum() + 2 * still * len(seams)
    if needed <= period:
        seams = seams + (period - needed) * seams / seams.sum()
    elif hurry:
        seams, moves, still = (part * period / needed for part in (seams, moves, still))
    else:
        return None
    stages = []
    for i, (seam, air) in enumerate(routes):
        begin, end = (seam.at(np.array([x]))[0] for x in (0.0, 1.0))
        stages += [build_dwell(begin, still), build_path_stage(seam, float(seams[i]), True)]
        stages += [build_dwell(end, still), build_path_stage(air, float(moves[i]), False)]
    return stages
