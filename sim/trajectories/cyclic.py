"""Spray painting: strokes to and fro over a panel, square to it, again and again.

The gun crosses the panel at an even speed and turns gently outside, works its way down
and up again, and swings out a little at the end of each stroke. The path is closed and
smooth, so the joint angles along it are a Fourier series, exact to rounding.
"""

import numpy as np

from residual.robot.robot import Robot
from sim.engine.kinematics import follow
from sim.synthetic.series import Series, evaluate
from sim.trajectories.limits import LimitError
from sim.trajectories.plan import Plan, check
from sim.trajectories.workpiece import Cell, Piece, cell, draw_piece, no_room

RAMP = 1.0  # s from rest to full speed, as sim.synthetic.series has it
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
