"""The Fourier motion that excites the base parameters best."""

import numpy as np
from scipy.optimize import minimize

from sim.synthetic.series import Series
from sim.trajectories.excitation import excitation
from sim.trajectories.fourier import (
    Arena,
    draw,
    draw_any,
    fit_in,
    room_left,
    sampled,
    shrunk,
)
from sim.trajectories.problem import Problem, problem

Array = np.ndarray

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
