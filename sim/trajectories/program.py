"""Motions put together from stages, each from rest to rest, and repeated."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from sim.synthetic.series import path_time
from sim.synthetic.stops import quintic

Array = np.ndarray
Motion = tuple[Array, Array, Array]  # q, qd and qdd, shapes (n, dof)

_RAMP = 0.2  # share of a stroke in which it gathers speed, and loses it again


@dataclass(frozen=True, eq=False, slots=True)
class Stage:
    """A part of a program.

    Attributes:
        time: How long it takes [s].
        motion: q, qd and qdd at times from its own start.
    """

    time: float
    motion: Callable[[Array], Motion]


def dwell(q: Array, time: float) -> Stage:
    """Return a stage in which nothing moves. Shape of q (dof,)."""

    def motion(t: Array) -> Motion:
        still = np.zeros((len(t), len(q)))
        return still + q, still, still

    return Stage(time, motion)


def move(start: Array, end: Array, time: float) -> Stage:
    """Return a move of all joints together, by a polynomial of fifth order."""
    return Stage(time, lambda t: quintic(start, end, time, t[:, None] / time))


@dataclass(frozen=True, eq=False, slots=True)
class Path:
    """Joint angles along a path, q(x) for x from 0 to 1.

    Attributes:
        coefficients: Of Chebyshev polynomials in 2 x - 1. Shape (order + 1, dof).
    """

    coefficients: Array

    def at(self, x: Array, times: int = 0) -> Array:
        """Return the d-th derivative by x. Shape (n, dof)."""
        slope = chebyshev.chebder(self.coefficients, times) * 2.0**times
        return chebyshev.chebval(2 * x - 1, slope).T


def nodes(count: int) -> Array:
    """Return where a path must be known, from 0 to 1, both included. (count,)."""
    return (chebyshev.chebpts2(count) + 1) / 2


def path(q: Array) -> Path:
    """Return the path through joint angles at the nodes. Shape (nodes, dof)."""
    points = chebyshev.chebpts2(len(q))
    return Path(chebyshev.chebfit(points, q, len(q) - 1))


def along(route: Path, time: float, steady: bool) -> Stage:
    """Return a stage that follows a path.

    Args:
        time: How long it takes [s].
        steady: Whether the speed along the path is even but for its ends; else the
            path is run through in the way of a quick move.
    """

    def motion(t: Array) -> Motion:
        if steady:
            ramp = _RAMP * time
            x, xd, xdd = (v / (time - ramp) for v in path_time(t, time, ramp))
        else:
            unit = quintic(np.zeros(1), np.ones(1), time, t[:, None] / time)
            x, xd, xdd = (v[:, 0] for v in unit)
        first, second = route.at(x, 1), route.at(x, 2)
        xd, xdd = xd[:, None], xdd[:, None]
        return route.at(x), first * xd, second * xd**2 + first * xdd

    return Stage(time, motion)


def shortest(stage: Stage, velocity: Array, acceleration: Array) -> float:
    """Return the time in which a stage just keeps speeds and accelerations [s].

    Slower by a factor, a stage from rest to rest has speeds lower by that factor and
    accelerations by its square.
    """
    _, qd, qdd = stage.motion(np.linspace(0, stage.time, 400))
    by_speed = (np.abs(qd) / velocity).max()
    by_acceleration = np.sqrt((np.abs(qdd) / acceleration).max())
    return stage.time * float(max(by_speed, by_acceleration))


def repeated(stages: list[Stage]) -> Callable[[Array], Motion]:
    """Return the motion that runs through the stages again and again."""
    ends = np.cumsum([stage.time for stage in stages])

    def motion(t: Array) -> Motion:
        own = np.mod(t, ends[-1])
        which = np.minimum(np.searchsorted(ends, own, side="right"), len(stages) - 1)
        parts = np.zeros((3, len(t), stages[0].motion(np.zeros(1))[0].shape[1]))
        for i, stage in enumerate(stages):
            rows = np.flatnonzero(which == i)
            inside = own[rows] - (ends[i] - stage.time)
            parts[:, rows] = stage.motion(np.clip(inside, 0.0, stage.time))
        q, qd, qdd = parts
        return q, qd, qdd

    return motion
