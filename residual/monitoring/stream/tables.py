"""A model fitted to healthy runs, with tables for what it has no name for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects._tables import TABLES
from residual.model.model import Model
from residual.model.term import Term
from residual.monitoring.stream.rows import Rows
from residual.monitoring.stream.seen import (
    all_coefficients,
    columns_of,
    is_slow,
    state_of,
    with_all,
)
from residual.recording import Array

_SPEEDS = (0.0, 0.1, 0.25, 0.4, 0.6, 0.8, 1.0)  # quantiles
_PLACES, _LOADS = 8, 5  # knots
_PULL = 1e-3  # share of the rows that the belief in the model weighs
_TINY = 1e-9
_AT_ONCE = 4096  # rows: what their columns take stays under 100 MB


@dataclass(frozen=True, eq=False, slots=True)
class Fit:
    """A model fitted to runs, and what it takes to leave one of them out.

    Attributes:
        start: The model before.
        grams: Normal equations of each run: matrix and right side.
    """

    start: Model
    grams: tuple[tuple[Array, Array], ...]

    @property
    def model(self) -> Model:
        """Fitted to all runs."""
        return self.without(-1)

    def without(self, index: int) -> Model:
        """Return the model fitted to all runs but one."""
        used = [g for i, g in enumerate(self.grams) if i != index]
        gram, right = (sum(parts) for parts in zip(*used, strict=True))
        scale = np.sqrt(np.diag(gram))
        live = scale > _TINY * max(float(scale.max()), _TINY)
        inner = gram[np.ix_(live, live)] / np.outer(scale[live], scale[live])
        step = np.linalg.solve(
            inner + _PULL * np.eye(int(live.sum())), right[live] / scale[live]
        )
        values = all_coefficients(self.start)
        values[live] += step / scale[live]
        return with_all(self.start, values)


def fitted(model: Model, runs: Sequence[Rows]) -> Fit:
    """Fit a model to healthy runs: its own coefficients and tables, then by load too.

    Twice, since a joint weighs by what is left of its torque; and tables over the load
    come last, whose knots would move with the body that is fitted.

    Args:
        model: Where to start, with tables of speed and position.
        runs: Healthy runs.
    """
    weight = 1.0 / np.maximum(_rms([r.tau for r in runs]), _TINY)
    first = Fit(model, tuple(_normal(model, r, weight) for r in runs)).model
    left = [r.tau - first.torque_of_state(state_of(first, r)) for r in runs]
    moving = [
        np.where(is_slow(first, r), 0.0, x) for x, r in zip(left, runs, strict=False)
    ]
    weight = 1.0 / np.maximum(_rms(moving), _TINY)
    loaded = _with_loads(first, runs)
    return Fit(loaded, tuple(_normal(loaded, r, weight) for r in runs))


def with_tables(model: Model, runs: Sequence[Rows]) -> Model:
    """Return a model with empty tables over speed and position of every joint."""
    speed = np.abs(np.vstack([r.qd for r in runs]))
    place = np.vstack([r.q for r in runs])
    tables = [*model.tables]
    for j in range(model.robot.dof):
        knots = np.quantile(speed[:, j], _SPEEDS)
        tables.append(_empty("table_of_speed", j, knots, 2))
        knots = np.linspace(place[:, j].min(), place[:, j].max(), _PLACES)
        tables.append(_empty("table_of_position", j, knots, 1))
    return replace(model, tables=tuple(tables))


def _with_loads(model: Model, runs: Sequence[Rows]) -> Model:
    load = np.vstack([state_of(model, r).rigid for r in runs])
    tables = [*model.tables]
    for j in range(model.robot.dof):
        ends = np.quantile(load[:, j], (0.005, 0.995))
        tables.append(_empty("table_of_load", j, np.linspace(*ends, _LOADS), 2))
    return replace(model, tables=tuple(tables))


def _empty(name: str, joint: int, knots: Array, each: int) -> Term:
    shape = tuple(float(x) for x in knots)
    return Term(TABLES[name], (joint,), shape, np.zeros(each * len(shape)))


def _normal(model: Model, rows: Rows, weight: Array) -> tuple[Array, Array]:
    size = len(all_coefficients(model))
    gram, right = np.zeros((size, size)), np.zeros(size)
    for first in range(0, len(rows.t), _AT_ONCE):
        part = rows[first : first + _AT_ONCE]
        state = state_of(model, part)
        use = ~is_slow(model, part) * weight
        left = (part.tau - model.torque_of_state(state)) * use
        columns = (columns_of(model, state) * use[..., None]).reshape(-1, size)
        gram += columns.T @ columns
        right += columns.T @ left.ravel()
    return gram, right


def _rms(parts: Sequence[Array]) -> Array:
    return np.sqrt(np.mean(np.vstack(parts) ** 2, axis=0))
