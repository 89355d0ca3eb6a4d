"""Learn from healthy runs what is usual of an arm, and set limits.

Undeclared friction is no fault: tables over speed, position and load take up what the
model leaves. Each run is judged by what the others taught, so no limit is set on what
it was fitted to. A quantity is looked for from a size on that healthy runs do not
imitate, and its limit is that of `usual.tail_limit` on the sums of healthy runs: Page's
test has a mean time between false alarms of at least e^limit where the noise is as
modelled (Lorden 1971), and here it is not quite.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.errors import InputError
from residual.model.model import Model
from residual.monitoring.monitor import LEAST_RUNS, check_limits, check_log
from residual.monitoring.stream.cusum import whiten
from residual.monitoring.stream.reference import Reference
from residual.monitoring.stream.rows import Rows, Samples, Window, start, take
from residual.monitoring.stream.seen import (
    LOAD,
    features,
    felt_by,
    pointwise,
    quantities,
)
from residual.monitoring.stream.tables import fitted, with_tables
from residual.monitoring.stream.watch import (
    MEMORY,
    Evidence,
    add_up,
    begin,
    evidence,
)
from residual.monitoring.usual import BLOCK, Tail, tail_limit, tail_of
from residual.recording import Array, Recording
from residual.signals.track import sample_rate

PER_HOUR = 0.1
_ORDER = 4  # lags of the filter that makes a residual white
# Changes worth an alarm: shares of the arm's mass, of one, of a joint's usual torque.
_WORTH = {LOAD: 0.007, "gain": 0.2, "bias": 0.2, "friction": 0.2}
_IMITATED = 2.0  # times what healthy runs imitate, at least
_SHARE = 0.95  # of the blocks of a healthy run that imitate less
_LEAST_LIMIT = 10.0  # nats
_SURE = 4.0  # standard deviations in what healthy runs imitate, squared
_SEEN = 0.5  # of the usual information: blocks with less say nothing of a size


def learn(
    model: Model, recordings: Sequence[Recording], per_hour: float = PER_HOUR
) -> Reference:
    """Learn what is usual.

    Args:
        model: Expects the torque; needs its `speed_floor`. Effects that remember or
            need a clock are left out of it.
        recordings: Healthy runs such as will be watched: the same kinds of motion, cold
            and warm. Three at least; minutes of each kind are better.
        per_hour: False alarms wanted at most, all quantities together [1/h].

    Raises:
        InputError: If there are too few runs, or one does not fit the others.
    """
    rate = _checked(model, recordings, per_hour)
    runs = [rows_of(run, Window(rate)) for run in recordings]
    plain, _ = pointwise(model)
    fit = fitted(with_tables(plain, runs), runs)
    lowest, highest = _range(runs)
    many = len(quantities(model.robot.dof))
    bare = Reference(
        model=fit.model,
        rate=rate,
        filters=np.zeros((_ORDER, model.robot.dof)),
        sigma=np.ones(model.robot.dof),
        felt=np.mean([felt_by(fit.model, r) for r in runs], axis=0).round(),
        prior=np.full(many, np.inf),
        usual=np.zeros(many),
        sizes=_worth(model, runs),
        limits=np.empty(0),
        tails=(),
        per_hour=per_hour,
        hours=sum(run.duration for run in recordings) / 3600.0,
        lowest=lowest,
        highest=highest,
    )
    known = [_knowing(bare, fit.without(i), runs, i) for i in range(len(runs))]
    filters, sigma = _noise(known, runs)
    noisy = [replace(own, filters=filters, sigma=sigma) for own in known]
    return _with_limits(replace(bare, filters=filters, sigma=sigma), noisy, runs)


def _knowing(
    bare: Reference, model: Model, runs: Sequence[Rows], without: int
) -> Reference:
    """Return what all runs but one teach."""
    low, high = _range([r for i, r in enumerate(runs) if i != without])
    return replace(bare, model=model, lowest=low, highest=high)


def _range(runs: Sequence[Rows]) -> tuple[Array, Array]:
    """Lowest and highest q, qd and qdd of each joint. Shapes (3, dof)."""
    states = np.concatenate([np.stack([r.q, r.qd, r.qdd], axis=1) for r in runs])
    return states.min(axis=0), states.max(axis=0)


def rows_of(recording: Recording, window: Window) -> Rows:
    """Return the rows of a whole log."""
    samples = Samples(recording.t, recording.q, recording.tau)
    return take(start(recording.dof), samples, window)[1]


def _checked(model: Model, runs: Sequence[Recording], per_hour: float) -> float:
    """Check that runs can teach; return their rate [Hz]."""
    if len(runs) < LEAST_RUNS:
        raise InputError(
            f"{len(runs)} healthy runs, expected at least {LEAST_RUNS}: limits are set "
            "on runs that were left out. Give more runs of the healthy robot."
        )
    check_limits(model, per_hour)
    rate = sample_rate(runs[0].t)
    if Window(rate).half < 2:
        raise InputError(
            f"{runs[0].id} is logged at {rate:g} Hz, expected at least 60 Hz."
        )
    for run in runs:
        check_log(run, model, rate)
    return rate


def _worth(model: Model, runs: Sequence[Rows]) -> Array:
    """Smallest change of each quantity that is worth an alarm. Shape (h,)."""
    torque = np.sqrt(np.mean(np.vstack([r.tau for r in runs]) ** 2, axis=0))
    mass = sum(body.mass for body in model.robot.model.inertias)
    scale = {LOAD: np.full(model.robot.dof, mass), "gain": np.ones(model.robot.dof)}
    return np.array(
        [
            _WORTH[q.name] * scale.get(q.name, torque)[q.joint - 1]
            for q in quantities(model.robot.dof)
        ]
    )


def _noise(known: Sequence[Reference], runs: Sequence[Rows]) -> tuple[Array, Array]:
    """Fit the filter of each joint to what is left of its torque, and its rest.

    Args:
        known: What the others teach, for each run.
        runs: The runs.

    Returns:
        a_i, shape (p, dof), and standard deviation of the rest, shape (dof,).
    """
    dof = known[0].dof
    parts = [_residual(own, rows) for own, rows in zip(known, runs, strict=True)]
    filters, sigma = np.zeros((_ORDER, dof)), np.ones(dof)
    for j in range(dof):
        lags = np.vstack([_lagged(r[:, j])[use[:, j]] for r, use in parts])
        now = np.concatenate([r[use[:, j], j] for r, use in parts])
        if len(now) <= 10 * _ORDER:
            raise InputError(
                f"Joint {j + 1} hardly moves in the healthy runs: {len(now)} rows in "
                "motion. Give runs that move it."
            )
        gram = lags.T @ lags
        ridge = 1e-6 * np.trace(gram) * np.eye(_ORDER)
        filters[:, j] = np.linalg.solve(gram + ridge, lags.T @ now)
        rest = now - lags @ filters[:, j]
        # Rare bursts are the tail's affair, not the noise's.
        sigma[j] = max(1.4826 * np.median(np.abs(rest)), 0.7 * rest.std(), 1e-9)
    return filters, sigma


def _residual(own: Reference, rows: Rows) -> tuple[Array, Array]:
    """What is left of a run's torque, and where it can be used. Shapes (m, dof)."""
    x, slow = features(own.model, rows, own.load)
    memory = round(MEMORY * own.window.row_rate)
    lags, rest = np.zeros((_ORDER, *x.shape[1:])), np.zeros(own.dof, np.int64)
    apart = slow | own.outside(rows)
    _, use, _ = whiten(x, apart, rows.begins, own.filters, memory, (lags, rest, 0))
    return x[..., 0], use


def _lagged(r: Array) -> Array:
    """The values before each value, the latest first. Shape (m, p)."""
    before = np.concatenate([np.zeros(_ORDER), r])
    return np.column_stack(
        [before[_ORDER - i - 1 : len(before) - i - 1] for i in range(_ORDER)]
    )


def _with_limits(
    bare: Reference, known: Sequence[Reference], runs: Sequence[Rows]
) -> Reference:
    joined = _one_after_the_other(known, runs)
    rows = round(BLOCK * bare.window.row_rate)
    usual = _imitated(joined, rows)
    sizes = np.maximum(bare.sizes, _IMITATED * usual)
    prior = _SURE / np.maximum(usual, 1e-12) ** 2
    sized = replace(bare, usual=usual, prior=prior, sizes=sizes)
    never = np.full(len(sizes), np.inf)
    _, _, trace = add_up(sized, begin(sized), joined, never)
    peaks = [_block_peaks(trace[:, h].max(axis=1), rows) for h in range(len(sizes))]
    wanted = bare.per_hour * BLOCK / 3600.0 / len(sizes)
    limits = [max(tail_limit(own, wanted), _LEAST_LIMIT) for own in peaks]
    tails: tuple[Tail, ...] = tuple(map(tail_of, peaks))
    return replace(sized, limits=np.array(limits), tails=tails)


def _one_after_the_other(known: Sequence[Reference], runs: Sequence[Rows]) -> Evidence:
    """Evidence of all runs as of one stream, each judged by what the others teach."""
    state, parts = begin(known[0]), []
    for own, rows in zip(known, runs, strict=True):
        state, part = evidence(own, state, rows)
        parts.append(part)
    names = ("z", "u", "moving")
    return Evidence(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


def _imitated(seen: Evidence, rows: int) -> Array:
    """Size of change that most blocks of healthy runs stay below. Shape (h,)."""
    count = max(1, len(seen.z) // rows)
    over, under = (
        x[: count * rows].reshape(count, -1, x.shape[1]).sum(axis=1)
        for x in seen.products
    )
    out = np.zeros(over.shape[1])
    for h in range(len(out)):
        told = under[:, h] > _SEEN * np.median(under[:, h])
        if told.any():
            out[h] = np.quantile(np.abs(over[told, h] / under[told, h]), _SHARE)
    return out


def _block_peaks(values: Array, rows: int) -> Array:
    return np.maximum.reduceat(values, np.arange(0, len(values), rows))
