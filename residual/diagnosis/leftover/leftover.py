"""What remains after the findings: what it depends on, joint by joint.

States come first (`curves`), since a function of the motion drifts and swings
with it; time is asked about what they leave (`time`). Where nothing beats
chance on left-out rows, nothing is said.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.adequacy import Adequacy, repeat
from residual.diagnosis.leftover.curves import (
    DIFFERENCE,
    DIRECTION,
    PLAIN,
    SUM,
    Curve,
    Rows,
    Variable,
    curves,
)
from residual.diagnosis.leftover.remainder import Dependence
from residual.diagnosis.leftover.time import Clock, Line, drift_of, line_of
from residual.evidence.design import Design
from residual.evidence.fit import Fit
from residual.model.compare import Cloud
from residual.recording import Array
from residual.signals.track import Track

REPEATABLE, TIME_DRIVEN = "repeatable", "time-driven"
OFF = 0.1  # turns by which a line must miss a whole number of them in a period
SHORTEST = 1.0  # s: blocks for a drift are never shorter, since noise remembers too


@dataclass(frozen=True, eq=False, slots=True)
class Leftover:
    """What one joint keeps, on the rows on which it moves.

    Attributes:
        joint: From 0.
        curves: State variables that predict it on left-out folds, best first.
        clocks: A spectral line, a drift: of what the curves leave.
        kind: "repeatable", "time-driven", or None where neither is known.
        cloud: Leftover over the variable that it depends on most.
    """

    joint: int
    curves: tuple[Curve, ...]
    clocks: tuple[Clock, ...]
    kind: str | None
    cloud: Cloud


def leftovers(
    design: Design, tracks: Sequence[Track], fitted: Fit, told: Adequacy
) -> tuple[Leftover, ...]:
    """Look at every joint on which more than noise remains.

    Args:
        told: What remains; the joints it doubts are looked at.
    """
    memory = np.array([_motion_memory(track) for track in tracks])
    return tuple(_of(design, tracks, (fitted, told, memory), j) for j in told.doubted)


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


def _of(design: Design, tracks, what, j: int) -> Leftover:
    fitted, told, memory = what
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
    cloud = _cloud(rows, (found, clocks), line, [t.id for t in tracks], j)
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
    return [v for v in out if np.ptp(v.values) > 0]


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
    free = len(turns) < len(tracks) or any(abs(x - round(x)) > OFF for x in turns)
    return len(tracks) > 1 and free


def _cloud(rows: Rows, told, line: Line, names: Sequence[str], j: int) -> Cloud:
    """Leftover over the variable it depends on most; over time where there is none."""
    found, clocks = told
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
    return max(SHORTEST, float(zero.max(initial=0)))


def _stack(tracks: Sequence[Track], j: int, lines: Sequence[Array]) -> Array:
    """Values of all logs on the rows on which a joint moves."""
    pairs = zip(tracks, lines, strict=True)
    return np.concatenate([x[t.moving[:, j]] for t, x in pairs])
