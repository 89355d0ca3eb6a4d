"""What a model makes of rows: what is left of the torque, and what changes look like.

Every row is judged by itself, with the friction of its velocity's sign: effects with a
memory or a clock are left out of the model, and what they do is part of what is usual.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects import registry
from residual.effects.base import State
from residual.model.model import Model
from residual.monitoring.stream.rows import Rows
from residual.recording import Array
from residual.robot.robot import Robot

# What is watched on each joint, in the order of the features behind the load.
PER_JOINT = ("gain", "bias", "friction")
LOAD = "load"
UNITS = {LOAD: "kg", "gain": "1", "bias": "N m", "friction": "N m"}
_SLOW = 3.0  # standstill thresholds below which friction is not to be trusted
_REACH, _SURELY = 0.1, 3.0  # m off the flange, where a load may be; times as much
_ARM = 0.05  # m from the flange to the centre of a usual load


@dataclass(frozen=True, slots=True)
class Quantity:
    """One thing that may change.

    Attributes:
        name: load, gain, bias or friction.
        joint: Joint from 1; that of the flange for a load.
    """

    name: str
    joint: int

    @property
    def unit(self) -> str:
        """Unit of its size."""
        return UNITS[self.name]


def quantities(dof: int) -> tuple[Quantity, ...]:
    """Return what is watched, in the order of the features."""
    local = [Quantity(name, j + 1) for name in PER_JOINT for j in range(dof)]
    return (Quantity(LOAD, dof), *local)


def state_of(model: Model, rows: Rows) -> State:
    """Return what the effects see of rows, each by itself."""
    still = np.zeros(len(rows.t))
    return model.state(1.0, still, (rows.q, rows.qd, rows.qdd))


def features(model: Model, rows: Rows, load: Array) -> tuple[Array, Array]:
    """Return what is left of the torque, and what each change would add to it.

    Args:
        model: Expects the torque (`pointwise`).
        rows: The rows.
        load: Inertial parameters of one kilogram on the flange (`one_kilogram`).

    Returns:
        Measured minus expected torque [N m], torque per kilogram, expected torque, one
        and direction of motion, the last axis. Shape (m, dof, 5). And where a joint is
        too slow to tell, shape (m, dof), bool.
    """
    if not len(rows.t):
        return np.empty((0, model.robot.dof, 5)), np.empty(rows.q.shape, bool)
    state = state_of(model, rows)
    expected = model.torque_of_state(state)
    weight = state.regressor[:, :, -10:] @ load
    ones = np.ones(expected.shape)
    parts = (rows.tau - expected, weight, expected, ones, np.sign(rows.qd))
    return np.stack(parts, axis=2), is_slow(model, rows)


def is_slow(model: Model, rows: Rows) -> Array:
    """Where a joint is too slow for its friction to be trusted. Shape (m, dof)."""
    return np.abs(rows.qd) < _SLOW * model.speed_floor


def one_kilogram(robot: Robot) -> Array:
    """Return the inertial parameters of a kilogram on the flange. Shape (10,)."""
    (load,) = (
        effect
        for effect in registry().values()
        if effect.scope == "flange" and effect.carries == "body"
    )
    values = np.array([1.0, 0.0, 0.0, _ARM, *np.zeros(6)])
    return load.from_values(values, robot)[0]


def felt_by(model: Model, rows: Rows) -> Array:
    """Return which joints tell the mass of a load wherever its centre is.

    A wrist feels where it is more than how heavy it is.

    Returns:
        1 or 0. Shape (dof,); all 1 where no joint does.
    """
    regressor = state_of(model, rows).regressor[:, :, -10:]
    weight = np.sqrt(np.mean((regressor @ one_kilogram(model.robot)) ** 2, axis=0))
    centre = _REACH * np.sqrt(np.mean(regressor[:, :, 1:4] ** 2, axis=(0, 2)))
    felt = (weight > _SURELY * centre).astype(float)
    return felt if felt.any() else np.ones(len(felt))


def pointwise(model: Model) -> tuple[Model, tuple[str, ...]]:
    """Return a model that tells the torque of single states, and what it goes without.

    Args:
        model: Any model with its `speed_floor`.

    Returns:
        The model without effects that remember or need a clock, and their names.
    """

    def depends(term) -> bool:
        return term.effect.remembers or term.effect.needs_clock

    gone = tuple(dict.fromkeys(t.effect.name for t in model.terms if depends(t)))
    kept = tuple(term for term in model.terms if not depends(term))
    return replace(model, terms=kept).by_sign(), gone


def columns_of(model: Model, state: State) -> Array:
    """Return torque per coefficient: inertial, terms, tables. Shape (m, dof, p)."""
    dof = model.robot.dof
    parts = [state.regressor]
    for term in (*model.terms, *model.tables):
        own = term.effect.columns(state, term.joints, term.shape)
        part = np.zeros((len(state.t), dof, own.shape[2]))
        part[:, list(term.effect.rows(term.joints, dof))] = own
        parts.append(part)
    return np.concatenate(parts, axis=2)


def with_all(model: Model, values: Array) -> Model:
    """Return the model with other coefficients of `columns_of`. Shape (p,)."""
    size = len(model.coefficients())
    made = model.with_coefficients(values[:size])
    tables, first = [], size
    for table in model.tables:
        stop = first + len(table.theta)
        tables.append(replace(table, theta=values[first:stop]))
        first = stop
    return replace(made, tables=tuple(tables))


def all_coefficients(model: Model) -> Array:
    """Return the coefficients of `columns_of`. Shape (p,)."""
    thetas: Sequence[Array] = [t.theta for t in model.tables]
    return np.concatenate([model.coefficients(), *thetas])
