"""Welding: straight seams at even speed on a work piece, with air moves between them.

Of the same kind as pick and place, with more segments (G2017 section 2.1): the arm
stands still where a seam begins and ends. Seams and air moves are paths of poses; the
joint angles along each are a polynomial through its nodes, exact to rounding.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.geometry import follow
from sim.trajectories.curves import (
    Path,
    Stage,
    along,
    dwell,
    nodes,
    path,
    repeated,
    shortest,
)
from sim.trajectories.limits import LimitError, Limits
from sim.trajectories.plan import Plan, check
from sim.trajectories.workpiece import Cell, Piece, cell, draw_piece, no_room

_MOST, _LEAST = 8, 2  # seams per period
_PIECES = 150  # work pieces drawn at most
_TOO_FAST = 3  # pieces on which two seams were too fast, before giving up
_NODES = 33  # of a path
_DWELL = 0.2  # s, for the arc to start and the crater to fill
_EASE = 1.15  # what takes that much longer than it must
_AIR, _SEAM = 0.4, 0.8  # s, least times
_LEAN = 0.3  # rad by which a torch leans at most
_LIFT = 0.06  # of the stretched arm, above the piece between seams
_LENGTH = 0.7  # least length of a seam, in half widths of the piece


@dataclass(frozen=True, eq=False, slots=True)
class _Point:
    """Where the torch is: place on the piece, -1 to 1, and lean [rad]."""

    place: Array
    lean: Array


@dataclass(frozen=True, eq=False, slots=True)
class _Routes:
    """Joint angles along seams, and along the air move that follows each.

    The last air move leads back to the first seam.
    """

    seams: list[Path]
    moves: list[Path]


def plan_welding(
    robot: Robot, duration: float, periods: int, rng: np.random.Generator
) -> Plan:
    """Draw a work piece and weld as many seams per period as the limits allow.

    Args:
        duration: Length [s].

    Raises:
        LimitError: If even two seams per period are too fast.
        InputError: If the arm has too few joints or reaches no piece.
    """
    space = cell(robot, "welding")
    too_fast: list[LimitError] = []
    for _ in range(_PIECES):
        piece = draw_piece(space, rng)
        if piece is None:
            continue
        seams = [_draw_seam(piece, rng) for _ in range(_MOST)]
        if _routes(space, piece, seams) is None:
            continue
        found = _most_seams(space, piece, seams, (duration, duration / periods))
        if isinstance(found, Plan):
            return found
        too_fast += [found] if found else []
        if len(too_fast) == _TOO_FAST:
            break
    raise too_fast[0] if too_fast else no_room("welding", robot)


def _most_seams(
    space: Cell, piece: Piece, seams: list, times: tuple[float, float]
) -> Plan | LimitError | None:
    """Return the plan of as many seams as possible, or what is wrong with two."""
    (duration, period), problem = times, None
    for count in range(_MOST, _LEAST - 1, -1):
        routes = _routes(space, piece, seams[:count])
        if routes is None:
            continue
        stages = _timed(space.limits, routes, period, count == _LEAST)
        if stages is None:
            continue
        plan = Plan("welding", repeated(stages), duration, period, period)
        try:
            check(space.robot, plan)
            return plan
        except LimitError as error:
            problem = error
    return problem


def _draw_seam(piece: Piece, rng: np.random.Generator) -> tuple[_Point, _Point]:
    axes = np.array([piece.across, piece.along, np.cross(piece.across, piece.along)])
    lean = rng.uniform(-_LEAN, _LEAN, 3) @ axes
    ends = rng.uniform(-1, 1, (2, 2))
    while np.linalg.norm((ends[1] - ends[0]) * piece.half) < _LENGTH * piece.half[0]:
        ends = rng.uniform(-1, 1, (2, 2))
    return _Point(ends[0], lean), _Point(ends[1], lean)


def _routes(space: Cell, piece: Piece, seams: list) -> _Routes | None:
    """Return the joint angles along all paths, None where the arm cannot follow."""
    lift, found = _LIFT * space.ways.length, []
    last = piece.posture
    for (start, end), (after, _) in zip(seams, [*seams[1:], seams[0]], strict=True):
        for points, height in (((start, end), 0.0), ((end, after), lift)):
            targets = [_torch(piece, points, height, x) for x in nodes(_NODES)]
            q = follow(space.ways, targets, last, piece.posture)
            if q is None or not space.fits(q):
                return None
            found.append(q)
            last = q[-1]
    if np.abs(found[-1][-1] - found[0][0]).max() > 1e-6:
        return None  # back over the first seam in another posture
    return _Routes([path(q) for q in found[::2]], [path(q) for q in found[1::2]])


def _torch(piece: Piece, points: tuple, height: float, x: float) -> pin.SE3:
    """Return the pose of the flange on the way between two points, x from 0 to 1."""
    start, end = points
    place = start.place + x * (end.place - start.place)
    lean = start.lean + x * (end.lean - start.lean)
    return piece.pose(place[0], place[1], lean, height * 16 * x**2 * (1 - x) ** 2)


def _timed(
    limits: Limits, routes: _Routes, period: float, hurry: bool
) -> list[Stage] | None:
    """Return the stages of one period; what time is left goes to the seams.

    Returns:
        The stages; None where the period is too short, unless in a hurry: then all is
        so fast that it fits.
    """
    bounds = (limits.velocity, limits.acceleration)
    seams = np.array([shortest(along(r, 1.0, True), *bounds) for r in routes.seams])
    moves = np.array([shortest(along(r, 1.0, False), *bounds) for r in routes.moves])
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
    for i, (seam, air) in enumerate(zip(routes.seams, routes.moves, strict=True)):
        begin, end = (seam.at(np.array([x]))[0] for x in (0.0, 1.0))
        stages += [dwell(begin, still), along(seam, float(seams[i]), True)]
        stages += [dwell(end, still), along(air, float(moves[i]), False)]
    return stages
