"""The shared columns of a question on a motion, and their whitened Gram."""

from collections.abc import Sequence

import numpy as np

from residual.effects.base import State
from residual.planning.question import Question
from residual.recording import Array, Recording
from residual.signals.track import prepare, widened


def planned_gram(
    question: Question, motion: Sequence[Array], rate: float, seconds: float
) -> Array:
    """Return X' X of the shared columns on a planned motion, whitened. Shape (m, m).

    A planned motion has nothing above the identification filter but where a joint turns
    round, and there rows do not count: so nothing is filtered.

    Args:
        motion: q, qd and qdd of the whole motion, or of one of its periods. The more
            samples, the better effects with a memory are seen. Shapes (n, dof).
        rate: Samples per second [Hz].
        seconds: Length of the log that it, or its repetition, will fill [s].
    """
    signals = question.signals
    rows = signals.rate * max(seconds - 2 * signals.edge, 0.0)
    x = _whitened(question, motion, rate)
    flat = x.reshape(-1, x.shape[2])
    return rows / len(motion[0]) * flat.T @ flat


def growing_grams(
    question: Question, motion: Sequence[Array], rate: float, until: Sequence[float]
) -> list[Array]:
    """Return X' X of the shared columns on the first seconds of a motion, whitened.

    Args:
        motion: q, qd and qdd of all of it. Shapes (n, dof).
        rate: Samples per second [Hz].
        until: How many seconds, each more than the one before [s].
    """
    signals = question.signals
    x = np.sqrt(signals.rate / rate) * _whitened(question, motion, rate)
    first, total, out = signals.edge, 0.0, []
    for end in until:
        rows = slice(*(round(t * rate) for t in (first, max(end, first))))
        flat = x[rows].reshape(-1, x.shape[2])
        total = total + flat.T @ flat
        out.append(total)
        first = max(end, first)
    return out


def _whitened(question: Question, motion: Sequence[Array], rate: float) -> Array:
    """The shared columns in units of the noise, 0 where a joint stands. (n, dof, m)."""
    signals = question.signals
    t = signals.start + np.arange(len(motion[0])) / rate
    columns = every_column(question, question.seen_with.state(rate, t, motion))
    weight = signals.information * ~standing(question, motion[1], rate)
    return np.sqrt(weight)[:, :, None] * columns


def logged_products(
    question: Question, recording: Recording, until: Sequence[float]
) -> list[tuple[Array, Array]]:
    """Return X' X and X' y of a log up to some times from its first sample, whitened.

    Rows are filtered and left out as in a diagnosis.

    Args:
        until: Times [s].
    """
    floor, model = question.signals.speed_floor, question.nominal
    (track,), _ = prepare([recording], model.filters, floor)
    state = question.seen_with.observe(track)
    columns = track.filter(every_column(question, state))
    y = track.tau - track.filter(model.torque_on(track))
    root = np.sqrt(question.signals.information * track.moving)
    t = track.t[:: track.step] - track.t[0]
    out = []
    for end in until:
        rows = t < end
        x = (root[rows, :, None] * columns[rows]).reshape(-1, columns.shape[2])
        out.append((x.T @ x, x.T @ (root[rows] * y[rows]).ravel()))
    return out


def every_column(question: Question, state: State) -> Array:
    """Return the inertial columns and those of all effects. Shape (n, dof, m)."""
    n, dof = state.q.shape
    parts = [np.asarray(state.regressor)]
    for effect, joints, shape in question.effects:
        own = effect.columns(state, joints, shape)
        part = np.zeros((n, dof, own.shape[2]))
        part[:, list(effect.rows(joints, dof))] = own
        parts.append(part)
    return np.concatenate(parts, axis=2)


def standing(question: Question, qd: Array, rate: float) -> Array:
    """Return where a joint stands or turns round, and shortly before and after.

    Args:
        qd: Speeds [rad/s]. Shape (n, dof).
        rate: Samples per second [Hz].

    Returns:
        Shape (n, dof), bool.
    """
    still = np.abs(qd) < question.signals.speed_floor
    still |= np.diff(np.sign(qd), axis=0, prepend=np.sign(qd[:1])) != 0
    return widened(still, int(np.ceil(question.signals.margin * rate)))
