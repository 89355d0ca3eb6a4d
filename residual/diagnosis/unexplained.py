"""The leftover of one examined, looked at and corrected, with the sentences on it.

The default form of the data-driven tables (`residual/calibration/choice.py`): nothing,
PLSR, least squares, tables, whichever serves fit logs best that were left out. The
variables are the joint's own state and what its leftover was found to depend on.
"Nothing" means not correctable from the state. The logs held out for the proof have no
part in it (G2017 eq. 31, on top of the named effects).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.calibration.choice import Training, chosen_tables
from residual.calibration.effects import make_tables
from residual.diagnosis.adequacy import Adequacy, repeat
from residual.diagnosis.outcome import Examined
from residual.diagnosis.patterns import (
    DIRECTION,
    PLAIN,
    SUM,
    Clock,
    Curve,
    Line,
    Rows,
    Variable,
    curves,
    drift_of,
    line_of,
)
from residual.evidence.columns import fold_labels
from residual.evidence.design import Design
from residual.evidence.fit import Fit
from residual.evidence.rules import RULES
from residual.model.compare import Cloud
from residual.model.corrected import DIFFERENCE, Column, Corrected, Tables, read
from residual.model.model import Model
from residual.recording import Array
from residual.signals.splitting import logs_of
from residual.signals.track import Track
from residual.verdict.result import Dependence

REPEATABLE, TIME_DRIVEN = "repeatable", "time-driven"


# What remains after the findings: what it depends on, joint by joint.
#
# States come first (`curves`), since a function of the motion drifts and swings with
# it; time is asked about what they leave (`clocks`). Where nothing beats chance on
# left-out rows, nothing is said.


@dataclass(frozen=True, eq=False, slots=True)
class Leftover:
    """What one joint keeps, on the rows on which it moves."""

    joint: int  # from 0
    # State variables that predict it on left-out folds, best first.
    curves: tuple[Curve, ...]
    clocks: tuple[Clock, ...]  # a spectral line, a drift: of what the curves leave
    kind: str | None  # "repeatable", "time-driven", or None where neither is known
    cloud: Cloud  # leftover over the variable that it depends on most


def leftovers(
    design: Design, tracks: Sequence[Track], fitted: Fit, told: Adequacy
) -> tuple[Leftover, ...]:
    """Look at every joint on which more than noise remains.

    Args:
        told: What remains; the joints it doubts are looked at.
    """
    memory = np.array([_motion_memory(track) for track in tracks])
    return tuple(_of(design, tracks, fitted, told, memory, j) for j in told.doubted)


def depends_on(found: Sequence[Leftover]) -> tuple[Dependence, ...]:
    """What each joint's leftover varies with, the largest share of a joint first."""
    out = []
    for one in found:
        joint = one.joint + 1
        own = []
        for c in one.curves:
            of = tuple(k + 1 for k in c.variable.of)
            own.append(
                Dependence(joint, c.variable.on, of, c.variable.form, c.share, None)
            )
        for c in one.clocks:
            form = DIRECTION if c.by_direction else PLAIN
            own.append(Dependence(joint, c.on, (), form, c.share, c.frequency))
        out += sorted(own, key=lambda entry: -entry.share)
    return tuple(out)


def _of(
    design: Design,
    tracks: Sequence[Track],
    fitted: Fit,
    told: Adequacy,
    memory: Array,
    j: int,
) -> Leftover:
    left = design.residual(j, fitted.ids, fitted.theta)
    power = (told.structured[j] * design.rms[j]) ** 2 * len(left)
    log = _stack(tracks, j, [np.full(len(t.tau), k) for k, t in enumerate(tracks)])
    rows = Rows(
        left,
        np.unique(design.folds_of(j), return_inverse=True)[1],
        log,
        design.rows[j] / fitted.counted[j],
        power,
    )
    variables = _variables(design, tracks, j)
    found, rest = curves(rows, variables)
    times = [s.t[:: t.step] for s, t in zip(design.states, tracks, strict=True)]
    line = Line(
        _stack(tracks, j, times),
        rest,
        log,
        np.sign(_stack(tracks, j, [t.qd[:: t.step, j] for t in tracks])),
        power,
        memory,
        min(t.cutoff for t in tracks),
    )
    # A drift has low frequencies, a slow wave drifts: only the stronger is told.
    clocks = [c for c in (line_of(line), drift_of(line)) if c is not None]
    clocks = sorted(clocks, key=lambda c: -c.share)[:1]
    kind = _kind(told.kind[j], found, clocks, tracks)
    cloud = _cloud(rows, found, clocks, line, [t.id for t in tracks], j)
    return Leftover(j, tuple(found), tuple(clocks), kind, cloud)


def _variables(design: Design, tracks: Sequence[Track], j: int) -> list[Variable]:
    """What the leftover of a joint may depend on: its own state, load, other joints."""

    def read(name: str) -> list[Array]:
        """Values of every joint on the rows of this one."""
        states = zip(design.states, tracks, strict=True)
        lines = [getattr(s, name)[:: t.step] for s, t in states]
        return list(_stack(tracks, j, lines).T)

    q, qd, qdd, tau = map(read, ("q", "qd", "qdd", "tau_model"))
    side = (qd[j] > 0).astype(int)
    own = [("q", q[j]), ("qdd", qdd[j]), ("tau", tau[j])]
    out = [Variable("qd", (j,), PLAIN, qd[j])]
    out += [Variable(on, (j,), PLAIN, x) for on, x in own]
    out += [Variable(on, (j,), DIRECTION, x, side) for on, x in own]
    for k in range(design.dof):
        if k != j:
            out += [
                Variable(on, (k,), PLAIN, x[k])
                for on, x in (("q", q), ("qd", qd), ("qdd", qdd))
            ]
            out.append(Variable("q", (j, k), SUM, q[j] + q[k]))
            out.append(Variable("q", (j, k), DIFFERENCE, q[j] - q[k]))
    slides = design.states[0].robot.prismatic
    return [
        replace(v, slides=slides[v.of[0]])
        for v in out
        # Of an angle and a length there is no sum.
        if np.ptp(v.values) > 0 and len({slides[k] for k in v.of}) == 1
    ]


def _kind(
    repeats: str | None,
    found: Sequence[Curve],
    clocks: Sequence[Clock],
    tracks: Sequence[Track],
) -> str | None:
    """State-driven if left-out logs are predicted from the state; else by the clock.

    Where a motion repeats, what does not repeat with it has the say. A line that logs
    of different motion share follows time, whatever period it happens to fit.
    """
    by_state = sum(c.share for c in found)
    by_time = max(clocks, key=lambda c: c.share, default=None)
    if by_time is None or by_state >= by_time.share:
        return repeats or (REPEATABLE if found else None)
    if by_time.frequency is None:
        return repeats or TIME_DRIVEN
    return TIME_DRIVEN if _foreign(by_time.frequency, tracks) else repeats


def _foreign(frequency: float, tracks: Sequence[Track]) -> bool:
    """Whether a line is none of the motion's own harmonics in some of several logs."""
    turns = [
        frequency * period * track.step / track.rate
        for track in tracks
        if (period := repeat(track)) is not None
    ]
    free = len(turns) < len(tracks) or any(abs(x - round(x)) > RULES.off for x in turns)
    return len(tracks) > 1 and free


def _cloud(
    rows: Rows,
    found: Sequence[Curve],
    clocks: Sequence[Clock],
    line: Line,
    names: Sequence[str],
    j: int,
) -> Cloud:
    """Leftover over the variable it depends on most; over time where there is none."""
    x, y, fitted, label = line.t, rows.left, np.zeros(len(line.t)), "t [s]"
    first = clocks[0] if clocks else None
    if found and (first is None or found[0].share >= first.share):
        x, fitted = found[0].variable.values, found[0].fitted
        label = found[0].variable.label
    elif first is not None and first.frequency is not None:
        y = line.left
        x, fitted = _folded(line, first.frequency)
        label = f"turns of {first.frequency:.3g} Hz"
    elif first is not None and first.by_direction:
        y, label = line.side * line.left, "t [s], turned with the direction of motion"
    return Cloud("", j + 1, label, x, y, fitted, np.array(names)[rows.log])


def _folded(line: Line, frequency: float) -> tuple[Array, Array]:
    """Turns of a wave from its crest in each log, and the wave of all logs [N m]."""
    turns = line.t * frequency
    for log in np.unique(line.log):
        own = line.log == log
        wave = line.left[own] @ np.exp(2j * np.pi * turns[own])
        turns[own] -= np.angle(wave) / (2 * np.pi)
    wave = np.cos(2 * np.pi * turns)
    return turns % 1, wave * (wave @ line.left) / (wave @ wave)


def _motion_memory(track: Track) -> float:
    """Time after which every joint has forgotten where it was [s], 1 s at least.

    The first zero of the autocovariance of its position; a joint that creeps through
    a whole log counts with that log.
    """
    q = track.q[:: track.step] - track.q.mean(axis=0)
    spectrum = np.fft.rfft(q, 2 * len(q), axis=0)
    lags = np.fft.irfft(spectrum * spectrum.conj(), axis=0)[: len(q)]
    moving = track.moving.any(axis=0)
    zero = np.argmax(lags <= 0, axis=0)[moving] * track.step / track.rate
    return max(RULES.shortest, float(zero.max(initial=0)))


def _stack(tracks: Sequence[Track], j: int, lines: Sequence[Array]) -> Array:
    """Values of all logs on the rows on which a joint moves."""
    pairs = zip(tracks, lines, strict=True)
    return np.concatenate([x[t.moving[:, j]] for t, x in pairs])


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
    X, Y, tau, second, seconds = [], [], [], [], 0
    for track, state, torque in logs:
        rows = slice(None, None, track.step)
        load = track.filter(torque[:, j])[track.inner]
        X.append(np.column_stack(read(state, columns))[rows][track.inner])
        tau.append(track.tau[track.inner, j])
        Y.append(tau[-1] - load)
        t = track.t[rows][: len(track.inner)][track.inner]
        second.append(seconds + (t - track.t[0]).astype(int))
        seconds = 1 + max(seconds, int(second[-1].max(initial=0)))
    fold = _folds([track for track, _, _ in logs])
    thin = slice(None, None, 1 + len(fold) // MOST_ROWS)
    X, Y, tau, second = (np.concatenate(part)[thin] for part in (X, Y, tau, second))
    if not _checkable(X, fold[thin]):
        return None
    loads = (tau - Y)[:, None]
    names = [f"{on}{'-' if f == DIFFERENCE else '+'}{of}" for on, of, f in columns]
    speeds = [i for i, (on, _, _) in enumerate(columns) if on == "qd"]
    tables = make_tables(X, loads, (0,), (*names, "load"), speeds)
    Z = tables.encode(X, loads)
    training = Training(X, Y[:, None], tau[:, None], second, Z)
    lookup, (option,) = chosen_tables(training, fold[thin], tables)
    return Tables(j, columns, lookup, option.kind)


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


@dataclass(frozen=True, eq=False, slots=True)
class Remains:
    """What is known of the leftover."""

    joints: tuple[Leftover, ...]  # one entry per unexplained joint
    # The model with a statistical correction; None where nothing is left, or no joint
    # can be checked.
    correction: Corrected | None
    sentences: tuple[str, ...]  # sentences


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
    belong = [j for j, part in zip(joints, loading, strict=True) if part > RULES.shared]
    chance = RULES.sure_shared / np.sqrt(fitted.counted[joints].min())
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
