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
from residual.diagnosis.adequacy import Adequacy, find_period
from residual.diagnosis.outcome import SearchOutcome
from residual.diagnosis.patterns import (
    DIRECTION,
    PLAIN,
    SUM,
    Curve,
    JointResidual,
    TimeLine,
    Variable,
    Wave,
    curves,
    wave_of,
)
from residual.errors import joints_listed
from residual.evidence.columns import fold_labels
from residual.evidence.design import Design
from residual.evidence.fit import Fit
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import Cloud
from residual.model.lookup import DIFFERENCE, Column, CorrectedModel, Tables, read
from residual.model.model import Model
from residual.recording import Array
from residual.signals.splitting import logs_of
from residual.signals.track import Track
from residual.verdict.result import Dependence

REPEATABLE, TIME_DRIVEN = "repeatable", "time-driven"


# What remains after the findings: what it depends on, joint by joint.
#
# States come first (`curves`), since a function of the motion swings with it; a wave in
# time is searched in what they leave (`wave_of`). Where nothing beats chance on
# left-out rows, nothing is said.


@dataclass(frozen=True, eq=False, slots=True)
class JointLeftover:
    """What one joint keeps, on the rows on which it moves."""

    joint: int  # from 0
    # State variables that predict it on left-out folds, best first.
    curves: tuple[Curve, ...]
    wave: Wave | None  # a spectral line of what the curves leave
    kind: str | None  # "repeatable", "time-driven", or None where neither is known
    cloud: Cloud  # leftover over the variable that it depends on most


def depends_on(leftovers: Sequence[JointLeftover]) -> tuple[Dependence, ...]:
    """What each joint's leftover varies with, the largest share of a joint first."""
    out = []
    for leftover in leftovers:
        joint, entries = leftover.joint + 1, []
        for c in leftover.curves:
            v = c.variable
            of = tuple(k + 1 for k in v.of)
            entries.append(Dependence(joint, v.on, of, v.form, c.share, None))
        if (wave := leftover.wave) is not None:
            entries.append(
                Dependence(joint, "frequency", (), PLAIN, wave.share, wave.frequency)
            )
        out += sorted(entries, key=lambda entry: -entry.share)
    return tuple(out)


def joint_leftovers(
    design: Design, tracks: Sequence[Track], fitted: Fit, adequacy: Adequacy
) -> tuple[JointLeftover, ...]:
    """Look at every joint on which more than noise remains."""
    out = []
    for j in adequacy.doubted:
        residual = design.residual(j, fitted.ids, fitted.theta)
        power = (adequacy.structured[j] * design.rms[j]) ** 2 * len(residual)
        log = _stack(tracks, j, [np.full(len(t.tau), k) for k, t in enumerate(tracks)])
        rows = JointResidual(
            residual,
            np.unique(design.folds_of(j), return_inverse=True)[1],
            log,
            design.rows[j] / fitted.counted[j],
            power,
        )
        found_curves, remaining = curves(rows, _variables(design, tracks, j))
        times = [s.t[:: t.step] for s, t in zip(design.states, tracks, strict=True)]
        cutoff = min(t.cutoff for t in tracks)
        line = TimeLine(_stack(tracks, j, times), remaining, log, power, cutoff)
        wave = wave_of(line)
        kind = _kind(adequacy.kind[j], found_curves, wave, tracks)
        # Over the variable that it depends on most; over time where there is none.
        x, y, drawn, label = line.t, residual, np.zeros(len(line.t)), "t [s]"
        if found_curves and (wave is None or found_curves[0].share >= wave.share):
            x, drawn = found_curves[0].variable.values, found_curves[0].fitted
            label = found_curves[0].variable.label
        elif wave is not None:
            y = line.residual
            x, drawn = _folded(line, wave.frequency)
            label = f"turns of {wave.frequency:.3g} Hz"
        names = np.array([t.id for t in tracks])
        cloud = Cloud("", j + 1, label, x, y, drawn, names[log])
        out.append(JointLeftover(j, tuple(found_curves), wave, kind, cloud))
    return tuple(out)


def _variables(design: Design, tracks: Sequence[Track], j: int) -> list[Variable]:
    """Variables of a joint's residual: its state, its load, other joints."""

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
    curves_found: Sequence[Curve],
    wave: Wave | None,
    tracks: Sequence[Track],
) -> str | None:
    """State-driven if left-out logs are predicted from the state; else by the clock.

    Where a motion repeats, what does not repeat with it has the say. A line that logs
    of different motion share follows time, whatever period it happens to fit: it is
    none of the motion's own harmonics in some of several logs.
    """
    if wave is None or sum(c.share for c in curves_found) >= wave.share:
        return repeats or (REPEATABLE if curves_found else None)
    turns = [
        wave.frequency * period * track.step / track.rate
        for track in tracks
        if (period := find_period(track)) is not None
    ]
    free = len(turns) < len(tracks) or any(
        abs(x - round(x)) > THRESHOLDS.off_harmonic_turns for x in turns
    )
    return TIME_DRIVEN if len(tracks) > 1 and free else repeats


def _folded(line: TimeLine, frequency: float) -> tuple[Array, Array]:
    """Turns of a wave from its crest in each log, and the wave of all logs [N m]."""
    turns = line.t * frequency
    for log in np.unique(line.log):
        own = line.log == log
        wave = line.residual[own] @ np.exp(2j * np.pi * turns[own])
        turns[own] -= np.angle(wave) / (2 * np.pi)
    wave = np.cos(2 * np.pi * turns)
    return turns % 1, wave * (wave @ line.residual) / (wave @ wave)


def _stack(tracks: Sequence[Track], j: int, lines: Sequence[Array]) -> Array:
    pairs = zip(tracks, lines, strict=True)
    return np.concatenate([x[t.moving[:, j]] for t, x in pairs])


MOST_ROWS = 12_000  # more of the same logs change nothing but the time


def fit_correction(
    model: Model, tracks: Sequence[Track], leftovers: Sequence[JointLeftover]
) -> CorrectedModel | None:
    """Fit the correction to what a model leaves on the fit logs.

    Returns:
        None where no joint moves enough for one log, or block, to check another.
    """
    if not leftovers:
        return None
    states = [model.observe(t) for t in tracks]
    torque = [model.torque_of_state(s) for s in states]
    logs = list(zip(tracks, states, torque, strict=True))
    tables = [_tables(logs, one) for one in leftovers]
    kept = tuple(t for t in tables if t is not None)
    return CorrectedModel(model, kept) if kept else None


def _tables(logs, leftover: JointLeftover) -> Tables | None:
    j = leftover.joint
    columns = _columns(leftover)
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
    # Every variable must vary in all folds but any one.
    folds = np.unique(fold[thin])
    spread = [np.ptp(X[fold[thin] != f], axis=0) for f in folds]
    if len(folds) < 2 or not (np.array(spread) > 1e-9).all():
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


def _columns(leftover: JointLeftover) -> tuple[Column, ...]:
    """Own speed, position and acceleration, then the variables of the curves."""
    state_columns = [(on, (leftover.joint,), "") for on in ("qd", "q", "qdd")]
    used = {(on, of) for on, of, _ in state_columns}
    variables = [c.variable for c in leftover.curves if c.variable.on != "tau"]
    more = [(v.on, v.of, v.form) for v in variables if (v.on, v.of) not in used]
    return tuple(state_columns + more)


@dataclass(frozen=True, eq=False, slots=True)
class LeftoverAnalysis:
    """What is known of the leftover."""

    joints: tuple[JointLeftover, ...]  # one entry per unexplained joint
    # The model with a statistical correction; None where nothing is left, or no joint
    # can be checked.
    correction: CorrectedModel | None
    sentences: tuple[str, ...]  # sentences


def examine_leftover(
    outcome: SearchOutcome, fitted: Fit, augmented: Model
) -> LeftoverAnalysis:
    """Look at what the names leave on the fit logs; nothing held out has a part."""
    told, tracks = outcome.adequacy, outcome.logs.sketch
    found = joint_leftovers(outcome.task.design, tracks, fitted, told)
    made = fit_correction(augmented, tracks, found)
    sentences = ()
    if made is not None and made.helpless:
        on = joints_listed([j + 1 for j in made.helpless])
        sentences = (
            f"{on}: not correctable from state: tables of position, speed, "
            "acceleration and load do not help on logs left out",
        )
    return LeftoverAnalysis(found, made, sentences)
