"""The leftover of one examined, looked at and corrected, with the sentences on it.

The default form of the data-driven tables (`residual/tables/choose.py`) without pair
tables: nothing, least squares, main effects, the same with load, whichever serves fit
logs best that were left out. The variables are the joint's own state and what its
leftover was found to depend on. "Nothing" means not correctable from the state. The
logs held out for the proof have no part in it (G2017 eq. 31, on top of the named
effects).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.examine import Examined
from residual.diagnosis.leftover.leftover import Leftover, leftovers
from residual.evidence.fit import Fit
from residual.evidence.folds import fold_labels
from residual.model.corrected import DIFFERENCE, Column, Corrected, Tables, read
from residual.model.model import Model
from residual.recording import Array
from residual.signals.pieces import logs_of
from residual.signals.track import Track
from residual.tables.choose import fit_effect_tables
from residual.tables.form import EffectForm

LEVELS = (5, 10, 20)  # finer ones cost four times as much
MOST_ROWS = 12_000  # more of the same logs change nothing but the time


def corrected(
    model: Model, tracks: Sequence[Track], left: Sequence[Leftover]
) -> Corrected | None:
    """Fit the correction to what a model leaves on the fit logs.

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
    logs = logs_of([t.id for t in tracks])
    if len(logs) > 1:
        of = {i: k for k, pieces in enumerate(logs) for i in pieces}
        labels = [np.full(len(t.tau), of[i]) for i, t in enumerate(tracks)]
    else:
        labels = fold_labels(tracks)
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


SHARED = 0.6  # squared loading on a component from which a joint belongs to it
SURE = 3.0  # standard deviations of a correlation of so few effective rows


@dataclass(frozen=True, eq=False, slots=True)
class Remains:
    """What is known of the leftover.

    Attributes:
        joints: One entry per unexplained joint.
        correction: The model with a statistical correction; None where nothing is
            left, or no joint can be checked.
        sentences: Sentences.
    """

    joints: tuple[Leftover, ...]
    correction: Corrected | None
    sentences: tuple[str, ...]


def examine_leftover(examined: Examined, fitted: Fit, augmented: Model) -> Remains:
    """Look at what the names leave on the fit logs; nothing held out has a part."""
    told, tracks = examined.adequacy, examined.logs.sketch
    found = leftovers(examined.task.design, tracks, fitted, told)
    made = corrected(augmented, tracks, found)
    said = [_helpless(made), shared_source(examined, fitted)]
    return Remains(found, made, tuple(s for s in said if s))


def shared_source(examined: Examined, fitted: Fit) -> str | None:
    """Say so if one principal component holds what several joints keep.

    Leftovers are scaled to unit variance and compared on rows where both joints move.
    """
    joints = list(examined.adequacy.doubted)
    if len(joints) < 2:
        return None
    lines = np.stack([_line(examined, fitted, j) for j in joints])
    use = np.stack([_used(examined, j) for j in joints])
    power = lines**2 @ use.T
    correlation = lines @ lines.T / np.sqrt(np.maximum(power * power.T, 1e-300))
    values, vectors = np.linalg.eigh(correlation)
    loading = values[-1] * vectors[:, -1] ** 2
    belong = [j for j, part in zip(joints, loading, strict=True) if part > SHARED]
    chance = SURE / np.sqrt(fitted.counted[joints].min())
    if len(belong) < 2 or values[-1] - 1 < chance * (len(joints) - 1):
        return None
    share = 100 * loading[[joints.index(j) for j in belong]].mean()
    return (
        f"what joints {_list(belong)} keep moves together (one component holds "
        f"{share:.0f} % of it): look for one source"
    )


def _helpless(made: Corrected | None) -> str | None:
    if made is None or not made.helpless:
        return None
    many = "s" if len(made.helpless) > 1 else ""
    return (
        f"joint{many} {_list(made.helpless)}: not correctable from state: tables of "
        "position, speed, acceleration and load do not help on logs left out"
    )


def _line(examined: Examined, fitted: Fit, j: int) -> np.ndarray:
    """Leftover of a joint on the common time line, 0 where it does not move."""
    design = examined.task.design
    left = design.residual(j, fitted.ids, fitted.theta)
    return np.concatenate(design.series(j, left))


def _used(examined: Examined, j: int) -> np.ndarray:
    design = examined.task.design
    return np.concatenate(design.series(j, np.ones(len(design.target[j]))))


def _list(joints: Sequence[int]) -> str:
    return ", ".join(str(j + 1) for j in joints)
