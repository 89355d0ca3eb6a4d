"""Recordings in which nothing is missing, made after real ones, and searched.

The motion is the logged one, smoothed; the torque is that of the identified model.
Encoder and torque noise are redrawn as they were measured, and the nominal model is
redrawn around the truth as far off as it was found to be, so that its prior is tried
too. Every other draw has, in place of noise, what the fit itself left of the logs, in
blocks that are moved and turned over: a model is never quite the arm, and what it
leaves is not as harmless as noise. Several draws of torque noise share one of encoder
noise: what costs time is the columns, and they depend on the angles alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.detectable import select
from residual.diagnosis.examine import examine
from residual.diagnosis.gate import passed
from residual.diagnosis.neighbours import simplest
from residual.diagnosis.search import Candidates, Task, _shortlist, every_candidate
from residual.evidence.design import LAGS, Design
from residual.evidence.fit import Fit, System, fit, gain, possible
from residual.evidence.priors import Space, first_design, inertial_precision
from residual.evidence.rules import RULES
from residual.method.null_record import Key, key_of
from residual.model.model import Model
from residual.model.nominal import (
    Logs,
    Nominal,
    declared_names,
    prepare_logs,
    start_nominal,
)
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.splitting import session_clock, sketch_of
from residual.signals.standstill import SMOOTH, Standstill
from residual.signals.track import Filters, encoder_noise, smooth

FARTHEST = 0.3  # of the inertial parameters: a prior that is wider is as good as none
HIDDEN = 20.0  # displacements that a mask must be wide for its filter to leak none


@dataclass(frozen=True, eq=False, slots=True)
class Source:
    """What null recordings are made after."""

    # The logs; of long ones pieces that are evenly spread.
    recordings: tuple[Recording, ...]
    logs: Logs  # the same, ready
    nominal: Nominal  # the user's model
    truth: Model  # its structure with the parameters that the logs show
    scale: float  # relative scale of the rigid part that they show
    # Relative sd that they show of values given, by the effect's name.
    widths: Mapping[str, float] | None
    # Autocovariance of the torque's noise at the rows [N^2 m^2], (lags, dof).
    noise: Array
    # What the fit left of each log, 0 where masked [N m]. Each (m, dof).
    left: tuple[Array, ...]
    encoder: Array  # noise of the angles per log [rad], (logs, dof)
    key: Key  # what a null of these holds for


def source(
    robot: Robot,
    recordings: Sequence[Recording],
    declared: Sequence[str] | None = None,
) -> Source:
    """Measure on logs what null recordings of them need: a diagnosis of them.

    What it names is no part of the truth, yet explained, so that it is no noise.
    """
    names, filters = declared_names(robot, declared), Filters()
    clock = session_clock(recordings)
    asked = prepare_logs(robot, recordings, clock, filters)
    # Of long logs the draws are made after seven minutes.
    recordings = sketch_of(recordings)
    logs = prepare_logs(robot, recordings, clock, filters)
    nominal = start_nominal(logs, names)
    made = examine(logs, nominal, RULES, lambda stage, share: None)
    whole = made.model(made.fit).model
    truth = replace(
        whole,
        terms=whole.terms[: len(nominal.model.terms)],
        standstill=_out_of_sight(whole, logs),
    )
    design, fitted = made.task.design, made.fit
    # What the fit leaves of each log, joint by joint, as logged.
    joints = [
        design.series(j, design.residual(j, fitted.ids, fitted.theta))
        for j in range(design.dof)
    ]
    return Source(
        recordings=tuple(recordings),
        logs=made.logs,
        nominal=nominal,
        truth=truth,
        scale=made.task.prior.scale,
        widths=made.task.prior.widths,
        noise=autocovariance(design, fitted),
        left=tuple(np.column_stack(lines) for lines in zip(*joints, strict=True)),
        encoder=np.array([encoder_noise(r, filters) for r in recordings]),
        key=key_of(asked, nominal),
    )


def null_recordings(
    source: Source, rng: np.random.Generator
) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Recordings of the true model: as they are, and with the encoders' noise.

    Both without noise of the torque, which is added behind the filter.
    """
    clean, read = [], []
    for recording, sd in zip(source.recordings, source.encoder, strict=True):
        q = smooth(recording, source.logs.filters)
        own = replace(recording, q=q, qd=None, qdd=None, q_ref=None)
        own = replace(own, tau=source.truth.predict(own))
        clean.append(own)
        read.append(replace(own, q=q + sd * rng.normal(size=q.shape)))
    return tuple(clean), tuple(read)


def redrawn(source: Source, rng: np.random.Generator) -> Nominal:
    """The nominal model around the truth, as far off as the logs say.

    Coefficients of which nothing is given start from zero, as the user's do.
    """
    nominal, truth = source.nominal, source.truth
    size = len(truth.inertial)
    scale = min(source.scale, FARTHEST)
    lower = np.linalg.cholesky(inertial_precision(source.logs.robot) / scale**2)
    parts = [truth.inertial + np.linalg.solve(lower.T, rng.normal(size=size))]
    for term, was, given in zip(
        truth.terms, nominal.model.terms, nominal.given, strict=True
    ):
        width = None if given is None else source.widths[term.effect.name]
        chance = rng.normal(size=len(term.theta))
        around = term.theta * (1 + min(width or 0.0, FARTHEST) * chance)
        parts.append(was.theta if given is None else around)
    return replace(
        nominal, model=nominal.model.with_coefficients(np.concatenate(parts))
    )


def _out_of_sight(model: Model, logs: Logs) -> tuple[Standstill, ...]:
    """Each joint's standstill, if need be shorter: no more of it than the mask hides.

    Bristles that still turn round where rows count are presliding, which has a name.
    Behind a mask of width w a joint has gone its standstill speed times w at least.
    """
    way = logs.filters.margin / logs.span.cutoff * logs.speed_floor / HIDDEN
    shapes = model.standstill or (SMOOTH,) * len(way)
    return tuple(
        replace(s, size=min(s.size, float(w))) if s.kind == "bristle" else SMOOTH
        for s, w in zip(shapes, way, strict=True)
    )


LONGEST = 2 * LAGS  # rows over which noise is believed to remember


def autocovariance(design: Design, fitted: Fit) -> Array:
    """Autocovariance of what a fit leaves, at the rows' rate [N^2 m^2]. (lags, dof).

    Masked rows are left out of sums and counts alike. A fit takes a part of the noise
    with it: as many effective rows as it has parameters that the joint decides. The
    longer half of the lags fades to nothing (a flat-top window, Politis & Romano 1995).
    """
    fade = np.clip(2 - 2 * np.arange(LONGEST) / LONGEST, 0, 1)
    taken = _taken(design, fitted)
    out = np.zeros((LONGEST, design.dof))
    for j in range(design.dof):
        left = design.residual(j, fitted.ids, fitted.theta)
        values, used = design.series(j, left), design.series(j, np.ones_like(left))
        pairs = np.maximum(sum(_products(x) for x in used), 1.0)
        kept = max(1 - taken[j] / fitted.counted[j], 0.5)
        out[:, j] = fade * sum(_products(x) for x in values) / pairs / kept
    return out


def coloured(acov: Array, rows: int, rng: np.random.Generator) -> Array:
    """Gaussian noise of a given autocovariance, by circulant embedding. (rows, dof)."""
    lags, dof = acov.shape
    around = np.zeros((rows + 2 * lags, dof))
    around[:lags], around[-lags + 1 :] = acov, acov[:0:-1]
    # An estimate of a spectrum may fall below zero; what is cut off there is made up
    # for, so that the variance stays.
    spectrum = np.maximum(np.fft.rfft(around, axis=0).real, 0)
    variance = np.fft.irfft(spectrum, len(around), axis=0)[0]
    spectrum *= acov[0] / np.maximum(variance, 1e-300)
    white = np.fft.rfft(rng.normal(size=around.shape), axis=0)
    return np.fft.irfft(white * np.sqrt(spectrum), len(around), axis=0)[:rows]


def _products(line: Array) -> Array:
    """Sums of products of a line with itself, lag by lag. Shape (LONGEST,)."""
    spectrum = np.fft.rfft(line, 2 * len(line))
    sums = np.fft.irfft(spectrum * spectrum.conj())[: min(LONGEST, len(line))]
    return np.pad(sums, (0, LONGEST - len(sums)))


def _taken(design: Design, fitted: Fit) -> Array:
    """How many parameters each joint's rows decide (trace of the hat). (dof,)."""
    weight = fitted.weight(design.rows)
    covariance, out = fitted.covariance(), np.zeros(design.dof)
    for j in range(design.dof):
        place, have = design.present(j, fitted.ids)
        gram = design.total(j)[0][np.ix_(place, place)]
        out[j] = weight[j] * np.sum(gram * covariance[np.ix_(have, have)])
    return out


ALL = -1e9  # nats
BLOCK = 2.0  # s: longer than noise remembers, shorter than a motion


@dataclass(frozen=True, slots=True)
class Draw:
    """What one null recording showed (`null.Null`)."""

    nats: float
    net: float
    named: bool


def block(source: Source, seed: int, index: int, count: int) -> tuple[Draw, ...]:
    """Draws of torque noise and nominal that share one draw of encoder noise."""
    rng = np.random.default_rng([seed, index])
    logs, hiss = _noisy(source, rng)
    nominal = redrawn(source, rng)
    design = first_design(logs, nominal)
    candidates = every_candidate(design, nominal, logs.span, logs.clock is not None)
    out = [_searched(design, nominal, candidates)]
    for turn in range(1, count):
        make = _blocks if turn % 2 else _hiss
        another, fresh = redrawn(source, rng), make(source, logs, rng)
        moved = nominal.model.coefficients() - another.model.coefficients()
        target = design.stacked([b - a for a, b in zip(hiss, fresh, strict=True)])
        for j, change in enumerate(target):
            place, have = design.present(j, design.nominal)
            change += design.target[j] + design.columns(j, place) @ moved[have]
        out.append(_searched(design.with_target(target), another, candidates))
    return tuple(out)


def _searched(design: Design, nominal: Nominal, candidates: Candidates) -> Draw:
    """The whole choice of prior, search and gate; and the loudest of all candidates."""
    chosen = select(Space(design, nominal), candidates, RULES)
    task, named = chosen.task, False
    if chosen.fit.members:
        _, tested = passed(task, simplest(task, chosen.fit))
        named = bool(tested)
    nats, net = loudest(task, task.start())
    return Draw(nats, net, named)


def loudest(task: Task, base: Fit) -> tuple[float, float]:
    """Largest evidence of any one candidate on top of a fit, and less its price [nats].

    Whether it lowers the error by enough is not asked: a name must do that too.
    """
    open_rules = replace(task.rules, threshold=ALL)
    nats, net = [ALL], [ALL]
    own = System.of(task.design, task.prior, base.members)
    for group in _shortlist(replace(task, rules=open_rules), base, None, own):
        members = (*base.members, group)
        trial = fit(task.design, task.prior, members, task.design.rows / 4)
        trial = replace(trial, counted=base.counted)
        value, big, _ = gain(task.design, task.prior, trial, base)
        if possible(task.design, big, group):
            nats.append(float(value))
            net.append(float(value - task.candidates.cost(group)))
    return max(nats), max(net)


def _noisy(source: Source, rng: np.random.Generator) -> tuple[Logs, list[Array]]:
    """The logs of a block, ready, and the torque noise that is in them."""
    _, read = null_recordings(source, rng)
    old = source.logs
    logs = prepare_logs(old.robot, read, old.clock, old.filters)
    hiss = _hiss(source, logs, rng)
    tracks = tuple(
        replace(new, tau=new.tau + noise, torque_noise=was.torque_noise)
        for new, noise, was in zip(logs.tracks, hiss, old.tracks, strict=True)
    )
    return replace(logs, tracks=tracks), hiss


def _blocks(source: Source, logs: Logs, rng: np.random.Generator) -> list[Array]:
    """What the fit left, in blocks from other places, as often upside down.

    All joints move together: what one drive does to the next stays. Friction acts
    against the motion, and gears are as good forwards as backwards: so the sign may
    turn, and the time it comes at is not its cause.
    """
    whole = np.concatenate(source.left)
    rows = max(round(BLOCK * logs.tracks[0].rate / logs.tracks[0].step), 2)
    out = []
    for track in logs.tracks:
        parts = []
        for _ in range(-(-len(track.tau) // rows)):
            start = rng.integers(max(len(whole) - rows, 1))
            parts.append(rng.choice((-1.0, 1.0)) * whole[start : start + rows])
        out.append(np.concatenate(parts)[: len(track.tau)])
    return out


def _hiss(source: Source, logs: Logs, rng: np.random.Generator) -> list[Array]:
    return [coloured(source.noise, len(t.tau), rng) for t in logs.tracks]
