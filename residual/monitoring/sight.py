"""What a monitor knows of a log: its rows, and the torque that a model expects there.

tau = A(q, qd, qdd) theta, A the inertial regressor and the columns of the effects.
Least squares with a pull to the coefficients that the model came with, in units of the
torque that a coefficient makes: what the runs do not show stays as it was.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.effects.base import State
from residual.model.model import Model
from residual.monitoring.rows import LogRows, period_of, rows_of
from residual.monitoring.rules import MONITOR
from residual.recording import Array, Recording

_TINY = 1e-9
AT_ONCE = 40_000  # rows: ten minutes


@dataclass(frozen=True, eq=False, slots=True)
class Sight:
    """What is known of a log before it is judged.

    Attributes:
        rows: Motion and torque.
        model: What expects the torque.
        state: What its effects see.
        terms: Torque per unit of each coefficient of its effects. Shapes (m, dof, k).
        by_angle: Change of the torques with the angle of joint j, the last axis
            [N m/rad]. Shape (m, dof, dof).
        slow: The joint stands or has just stood. Shape (m, dof), bool.
        period: Length of a cycle of the program [s], None where nothing repeats.
    """

    rows: LogRows
    model: Model
    state: State
    terms: tuple[Array, ...]
    by_angle: Array
    slow: Array
    period: float | None

    def torque(self, theta: Array) -> Array:
        """Torque with these coefficients [N m]. Shape (m, dof)."""
        start = len(self.model.inertial)
        out = self.state.regressor @ theta[:start]
        for columns in self.terms:
            stop = start + columns.shape[2]
            out = out + columns @ theta[start:stop]
            start = stop
        return out

    def columns(self) -> Iterator[tuple[slice, Array]]:
        """Torque per unit of each coefficient, some rows at a time. (rows, dof, p)."""
        for first in range(0, len(self.rows.t), AT_ONCE):
            rows = slice(first, first + AT_ONCE)
            parts = [self.state.regressor[rows], *(x[rows] for x in self.terms)]
            yield rows, np.concatenate(parts, axis=2)


def sight_of(model: Model, recording: Recording) -> Sight:
    """Return what a model makes of a log.

    Raises:
        InputError: If the log is too short or too slow.
    """
    rows = rows_of(recording)
    state = model.observe(rows.track())
    slow = np.abs(rows.qd) < MONITOR.slow * model.speed_floor
    return Sight(
        rows=rows,
        model=model,
        state=state,
        terms=tuple(_columns(model, state)),
        by_angle=_by_angle(model, rows),
        slow=_remembered(slow, round(MONITOR.memory * rows.rate)),
        period=period_of(rows),
    )


def _columns(model: Model, state: State) -> Iterator[Array]:
    dof = state.q.shape[1]
    for term in model.terms:
        own = term.effect.columns(state, term.joints, term.shape)
        part = np.zeros((len(state.t), dof, own.shape[2]))
        part[:, list(term.effect.rows(term.joints, dof))] = own
        yield part


def fit(model: Model, logs: Sequence[Sight], without: int = -1) -> Array:
    """Fit the coefficients to logs, but for one of them.

    Args:
        without: Index of the log to leave out, -1 for none.

    Returns:
        Coefficients. Shape (p,).
    """
    theta = model.coefficients()
    square = [np.mean(log.rows.tau**2, axis=0) for log in logs]
    size = np.maximum(np.sqrt(np.mean(square, axis=0)), _TINY)
    gram, right = np.zeros((len(theta), len(theta))), np.zeros(len(theta))
    for log in (log for i, log in enumerate(logs) if i != without):
        use = (~log.slow & log.rows.whole[:, None]) / size
        left = (log.rows.tau - log.torque(theta)) * use
        for rows, columns in log.columns():
            weighed = (columns * use[rows][..., None]).reshape(-1, len(theta))
            gram += weighed.T @ weighed
            right += weighed.T @ left[rows].ravel()
    scale = np.sqrt(np.diag(gram))
    live = scale > _TINY * max(scale.max(), _TINY)
    inner = gram[np.ix_(live, live)] / np.outer(scale[live], scale[live])
    pull = MONITOR.pull * np.eye(int(live.sum()))
    step = np.linalg.solve(inner + pull, right[live] / scale[live])
    out = theta.copy()
    out[live] += step / scale[live]
    return out


def _by_angle(model: Model, rows: LogRows) -> Array:
    rigid = model.robot.model
    data, out = rigid.createData(), np.empty((*rows.q.shape, rows.q.shape[1]))
    for i in range(len(rows.t)):
        pin.computeRNEADerivatives(rigid, data, rows.q[i], rows.qd[i], rows.qdd[i])
        out[i] = data.dtau_dq
    return out


def _remembered(flag: Array, count: int) -> Array:
    """Keep each flag up for a number of rows after it. Shape (m, dof)."""
    total = np.cumsum(flag, axis=0)
    before = np.concatenate([np.zeros((count, flag.shape[1])), total])[: len(flag)]
    return total - before > 0
