"""A Fourier motion made better for a question, within the limits of the arm."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from flows.steps.planning.motions import COARSER, Search, series_gram
from sim.synthetic.series import Series
from sim.trajectories.fourier import (
    FREE,
    Arena,
    fit_in,
    free_of,
    harmonics,
    largest,
    room_left,
    shrunk,
)

Array = np.ndarray

_REACH = 0.85  # of half of the range, where the centre may lie
_SMALLEST = 0.05  # of the size that the limits allow a joint
_REGION = 0.3  # in which the first steps are taken
_NONE = 1e-3  # nats of a motion that is not possible


@dataclass(frozen=True, eq=False, slots=True)
class Form:
    """A Fourier motion as numbers near one: centres, form and size of every joint.

    Attributes:
        search: What is looked for.
        place: The arm's limits.
    """

    search: Search
    place: Arena

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.search.robot.dof

    def numbers(self, series: Series) -> Array:
        """Return the numbers of a motion. Shape (10 dof,)."""
        limits, free = self.place.limits, free_of(series)
        centre = (series.centre - limits.middle) / limits.half
        size = 1 / np.maximum(room_left(self.place, series), 1.0)
        form = free / np.maximum(np.linalg.norm(free, axis=0), 1e-12)
        return np.concatenate([centre, form.ravel(), size])

    def series(self, x: Array) -> Series | None:
        """Return the motion of some numbers, roughly within limits; None for none."""
        limits, dof = self.place.limits, self.dof
        centre = limits.middle + np.clip(x[:dof], -_REACH, _REACH) * limits.half
        free = x[dof:-dof].reshape(FREE, dof)
        whole = largest(self.place, Series(centre, *harmonics(free), self.place.period))
        share = np.clip(x[-dof:], _SMALLEST, 1.0)
        return fit_in(self.place, shrunk(whole, share), roughly=True)

    def cost(self, x: Array) -> float:
        """Return what a better motion makes smaller: minus ln of its worth."""
        series = self.series(x)
        if series is None:
            return -float(np.log(_NONE))
        gram = series_gram(self.search, self.place, series, COARSER)
        return -float(np.log(self.search.weighed(gram).worth + _NONE))


def improve(search: Search, place: Arena, series: Series, looks: int) -> Series:
    """Return a motion that promises more, by a local search from one."""
    form = Form(search, place)
    start = form.numbers(series)
    found = minimize(
        form.cost,
        start,
        method="COBYLA",  # the least of several pairs has kinks: no derivatives
        options={"maxiter": looks, "rhobeg": _REGION},
    )
    better = form.series(found.x)
    exact = None if better is None else fit_in(place, better)
    return series if exact is None else exact
