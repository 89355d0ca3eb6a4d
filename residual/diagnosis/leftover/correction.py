"""A statistical correction of what stays unexplained, if the state predicts it at all.

The default form of the data-driven tables (`residual/tables/choose.py`) without pair
tables: nothing, least squares, main effects, the same with load, whichever serves fit
logs best that were left out. The variables are the joint's own state and what its
leftover was found to depend on. "Nothing" means not correctable from the state. The
logs held out for the proof have no part in it (G2017 eq. 31, on top of the named
effects).
"""

from collections.abc import Sequence

import numpy as np

from residual.diagnosis.leftover.leftover import Leftover
from residual.evidence.design import fold_labels
from residual.model.corrected import DIFFERENCE, Column, Corrected, Tables, read
from residual.model.model import Model
from residual.recording import Array
from residual.signals.track import Track
from residual.tables.choose import fit_effect_tables
from residual.tables.form import EffectForm

LEVELS = (5, 10, 20)  # finer ones cost four times as much
MOST_ROWS = 12_000  # more of the same logs change nothing but the time


def corrected(
    model: Model, tracks: Sequence[Track], left: Sequence[Leftover]
) -> Corrected | None:
    """Fit the correction to what a model leaves on the fit logs.

    Args:
        model: The augmented model.
        tracks: The fit logs.
        left: What is known of the joints to correct.

    Returns:
        None where no joint moves enough for one log, or block, to check another.
    """
    if not left:
        return None
    states = [model.observe(t) for t in tracks]
    torque = [model.torque_of_state(s) for s in states]
    logs = list(zip(tracks, states, torque, strict=True))
    tables = [_tables(logs, one) for one in left]
    kept = tuple(t for t in tables if t is not None)
    return Corrected(model, kept) if kept else None


def _tables(logs, left: Leftover) -> Tables | None:
    j = left.joint
    columns = _columns(left)
    X, Y, tau = [], [], []
    for track, state, torque in logs:
        rows = slice(None, None, track.step)
        load = track.filter(torque[:, j])[track.inner]
        own = np.column_stack(read(state, columns))[rows][track.inner]
        X.append(np.column_stack([own, load]))
        tau.append(track.tau[track.inner, j])
        Y.append(tau[-1] - load)
    fold = _folds([track for track, _, _ in logs])
    thin = slice(None, None, 1 + len(fold) // MOST_ROWS)
    X, Y, tau = (np.concatenate(part)[thin] for part in (X, Y, tau))
    if not _checkable(X, fold[thin]):
        return None
    form = _form(columns)
    made = fit_effect_tables(X, Y[:, None], fold[thin], tau[:, None], form)
    return Tables(j, columns, made.lookup, made.chosen[0].kind)


def _folds(tracks: Sequence[Track]) -> Array:
    """Log of each row; blocks of it where it is the only one.

    Blocks of one log are next to each other, and a table may remember the path: with a
    second log there is something better to check it by.
    """
    if len(tracks) > 1:
        labels = [np.full(len(t.tau), k) for k, t in enumerate(tracks)]
    else:
        labels = fold_labels([len(t.tau) for t in tracks])
    return np.concatenate([f[t.inner] for f, t in zip(labels, tracks, strict=True)])


def _checkable(X: Array, fold: Array) -> bool:
    """Whether every variable varies in all folds but any one."""
    folds = np.unique(fold)
    spread = [np.ptp(X[fold != f], axis=0) for f in folds]
    return len(folds) > 1 and bool((np.array(spread) > 1e-9).all())


def _columns(left: Leftover) -> tuple[Column, ...]:
    """Own speed first, own position and acceleration, then what was found."""
    own = [(on, (left.joint,), "") for on in ("qd", "q", "qdd")]
    known = {(on, of) for on, of, _ in own}
    found = [c.variable for c in left.curves if c.variable.on != "tau"]
    more = [(v.on, v.of, v.form) for v in found if (v.on, v.of) not in known]
    return tuple(own + more)


def _form(columns: Sequence[Column]) -> EffectForm:
    names = [f"{on}{'-' if f == DIFFERENCE else '+'}{of}" for on, of, f in columns]
    return EffectForm(
        velocities=tuple(i for i, (on, _, _) in enumerate(columns) if on == "qd"),
        loads=((0, len(columns)),),
        names=(*names, "load"),
        pyramid=LEVELS,
        named=0,
        pairs=None,
    )
