"""Learn from healthy runs what is usual of an arm, and set limits.

The healthy runs are the first epoch: rows of all of them are fitted as those of
`diagnose --baseline` are, with all that any arm has a little of. Each run is then held
against what the others taught, window by window as it will be watched: by how much
windows differ beyond noise, and what evidence healthy ones show for changes that are
not there, of which `usual.tail_limit` makes limits.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from residual.epochs.window import SLOW, Looks, Rules, Usual, follow, nothing, products
from residual.errors import InputError
from residual.evidence.design import LAGS
from residual.evidence.fit import autocorrelation_time
from residual.model.model import Model
from residual.monitoring.monitor import LEAST_RUNS, check_limits, check_log
from residual.monitoring.rows import Rows, Samples, Window, start, take
from residual.monitoring.rules import MONITOR
from residual.monitoring.stream.first import AT_ONCE, Taught, fitted
from residual.monitoring.stream.reference import Reference, body_sd
from residual.monitoring.stream.watch import begin, waited
from residual.monitoring.usual import BLOCK, Tail, tail_limit, tail_of
from residual.recording import Array, Recording
from residual.signals.track import sample_rate

PER_HOUR = 0.1


def learn(
    model: Model,
    recordings: Sequence[Recording],
    per_hour: float = PER_HOUR,
    rules: Rules | None = None,
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
    bare = _bare(model, rate, per_hour, rules or Rules())
    lowest, highest = _range(runs)
    bare = replace(
        bare,
        lowest=lowest,
        highest=highest,
        hours=sum(run.duration for run in recordings) / 3600.0,
    )
    model = fitted(bare, runs)
    size = len(model.coefficients())
    bare = replace(
        bare,
        model=model,
        theta=np.zeros((bare.dof, size)),
        basis=np.zeros((bare.dof, size, 0)),
    )
    taught = Taught.of(bare, runs)
    known = _with_noise(taught.reference(bare), taught, runs)
    return _with_limits(known, taught, runs)


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


def pointwise(model: Model) -> Model:
    """Return a model that tells the torque of single states.

    Without effects that remember or need a clock; what they do is part of what is
    usual.
    """
    kept = [t for t in model.terms if not (t.effect.remembers or t.effect.needs_clock)]
    return replace(model, terms=(*kept, *model.tables), tables=()).by_sign()


def _bare(model: Model, rate: float, per_hour: float, rules: Rules) -> Reference:
    """A reference that knows no run yet."""
    plain, dof = pointwise(model), model.robot.dof
    size = len(plain.coefficients())
    ones = np.ones(dof)
    usual = Usual(
        noise=ones,
        unrest=np.ones((len(rules.windows), dof)),
        slow=np.ones((dof, SLOW)),
        quick=np.ones((dof, SLOW)),
        body=body_sd(model.robot),
        single=np.ones((dof, 5)),
    )
    return Reference(
        model=plain,
        rate=rate,
        theta=np.zeros((dof, size)),
        basis=np.zeros((dof, size, 0)),
        friction=np.ones((dof, 3)),
        usual=usual,
        limits=np.empty(0),
        tails=(),
        per_hour=per_hour,
        hours=0.0,
        lowest=np.full((3, dof), -np.inf),
        highest=np.full((3, dof), np.inf),
        rules=rules,
    )


def _range(runs: Sequence[Rows], without: int | None = None) -> tuple[Array, Array]:
    """Lowest and highest q, qd and qdd of each joint that two runs have. (3, dof).

    Of all runs but one what one has: so no state is watched that none was left out of.
    """
    used = [r for i, r in enumerate(runs) if i != without]
    states = [np.stack([r.q, r.qd, r.qdd], axis=1) for r in used]
    k = 1 if without is None else 0
    lowest = np.sort([x.min(axis=0) for x in states], axis=0)[k]
    return lowest, np.sort([x.max(axis=0) for x in states], axis=0)[-1 - k]


def _left_out(
    known: Reference, taught: Taught, runs: Sequence[Rows]
) -> Iterator[tuple[Array, Array]]:
    """Columns of each run by what the others taught, and where joints count."""
    for i, rows in enumerate(runs):
        lowest, highest = _range(runs, i)
        own = replace(known, theta=taught.fit(i)[0], lowest=lowest, highest=highest)
        use = taught.use[i] & ~own.outside(rows)
        parts = [
            own.columns(rows[k : k + AT_ONCE], use[k : k + AT_ONCE])
            for k in range(0, len(rows.t), AT_ONCE)
        ]
        yield np.concatenate(parts), use


def _with_noise(known: Reference, taught: Taught, runs: Sequence[Rows]) -> Reference:
    """Noise of rows, how far the slow differs between runs, and priors of changes."""
    dof = known.dof
    at = slice(1 + known.basis.shape[2], 1 + known.basis.shape[2] + SLOW)
    power, rows, means, infos = np.zeros(dof), np.zeros(dof), [], []
    lines: list[list[Array]] = [[] for _ in range(dof)]
    for columns, use in _left_out(known, taught, runs):
        r, s = columns[..., 0], columns[..., at]
        gram = np.einsum("mja,mjb->jab", s, s)
        gram = (
            gram
            + 1e-6
            * np.eye(SLOW)
            * (1 + np.trace(gram, axis1=1, axis2=2))[:, None, None]
        )
        mean = np.linalg.solve(gram, np.einsum("mja,mj->ja", s, r)[..., None])[..., 0]
        left = r - np.einsum("mja,ja->mj", s, mean)
        power, rows = power + (left**2).sum(axis=0), rows + use.sum(axis=0)
        means.append(mean)
        infos.append(gram)
        for j in range(dof):
            lines[j] += [left[:, j], np.zeros(LAGS)]
    variance = power / np.maximum(rows, 1.0) + (MONITOR.floor * taught.rms) ** 2
    pace = [max(autocorrelation_time(np.concatenate(own)), 1.0) for own in lines]
    noise = variance * np.array(pace)
    slow, quick = _between(known.rules, taught, noise, np.array(means), np.array(infos))
    return replace(
        known,
        basis=known.basis * np.sqrt(noise)[:, None, None],
        usual=replace(
            known.usual,
            noise=noise,
            slow=slow,
            quick=quick,
            single=_usual_sizes(known, taught),
        ),
    )


def _between(
    rules: Rules, taught: Taught, noise: Array, means: Array, infos: Array
) -> tuple[Array, Array]:
    """Deviation of the slow between runs, and with the motion. Shapes (dof, 2).

    Beyond noise. Runs that follow each other are as warm: what they differ by is that
    of their motions.
    """
    chance = np.einsum("rjaa->rja", np.linalg.inv(infos)) * noise[:, None]
    told = chance < 0.25 * np.maximum(means**2, chance.min(axis=0))
    squares = np.where(told, means**2 - chance, np.nan)
    most = np.nansum(squares, axis=0) / np.maximum(told.sum(axis=0), 1)
    least = np.column_stack(
        [np.full(len(noise), rules.warmth), rules.offset * taught.rms]
    )
    # One run of many that is cold makes the tail.
    far = MONITOR.largest * np.abs(np.where(told, means, 0.0)).max(axis=0)
    slow = np.maximum.reduce([np.sqrt(np.maximum(most, 0.0)), far, least])
    steps = np.quantile(np.abs(np.diff(means, axis=0)), 0.8, axis=0) / MONITOR.steps
    own = np.sqrt(np.maximum(steps**2 - np.median(chance, axis=0), 0.0))
    return slow, np.clip(own, rules.quick * slow, slow)


def _usual_sizes(known: Reference, taught: Taught) -> Array:
    """Coefficients of changes of usual size on each joint. Shape (dof, 5)."""
    size = np.maximum(known.friction, 1e-9)
    rms = taught.rms
    each = [
        rms / size[:, 0],
        rms,
        np.ones(len(rms)),
        rms / size[:, 1],
        rms / size[:, 2],
    ]
    return MONITOR.usual * np.column_stack(each)


def _with_limits(known: Reference, taught: Taught, runs: Sequence[Rows]) -> Reference:
    gram, clock = _bins(known, taught, runs)
    share, square = MONITOR.squares
    squares = np.concatenate([x.squares for x in _looks(known, gram, clock)])
    by_window = squares.transpose(1, 2, 0, 3).reshape(*squares.shape[1:3], -1)
    enough = np.isfinite(by_window).sum(axis=-1) > 20
    by_window = np.where(enough[..., None], by_window, square)
    unrest = np.sqrt(np.nanquantile(by_window, share, axis=-1) / square)
    unrest = np.maximum(unrest, MONITOR.calm)
    known = replace(known, usual=replace(known.usual, unrest=unrest))
    nats = np.concatenate([x.nats().max(axis=1) for x in _looks(known, gram, clock)])
    bins = max(1, round(BLOCK * known.window.row_rate / known.rules.rows))
    peaks = np.maximum.reduceat(nats, np.arange(0, len(nats), bins), axis=0)
    wanted = known.per_hour * BLOCK / 3600.0 / nats.shape[1]
    # Chance shows evidence of x nats once in e^x looks at most, were all as modelled;
    # friction has most ways to change that are not followed.
    least = np.full(nats.shape[1], -MONITOR.safe * np.log(wanted))
    least[1 : 1 + known.dof] *= MONITOR.warm
    limits = [
        max(min(tail_limit(own, wanted), MONITOR.far * float(own.max())), low)
        for own, low in zip(peaks.T, least, strict=True)
    ]
    tails: list[Tail] = [tail_of(own) for own in peaks.T]
    return replace(known, limits=np.array(limits), tails=tuple(tails))


def _bins(
    known: Reference, taught: Taught, runs: Sequence[Rows]
) -> tuple[Array, Array]:
    """Bins of all runs one after the other, as the stream would cut them."""
    state, parts, clocks = begin(known), [], []
    pending = np.empty((0, known.dof, 10 + known.basis.shape[2]))
    for (columns, _), rows in zip(_left_out(known, taught, runs), runs, strict=True):
        moving = ~known.is_slow(rows).all(axis=1)
        pending = np.concatenate([pending, columns[moving]])
        state, bins = waited(known, state, rows)
        ends = [clock for _, _, clock in bins]
        many = sum(map(len, ends)) * known.rules.rows
        if many:
            parts.append(products(pending[:many], known.rules))
            clocks += ends
        pending = pending[many:]
    if not parts:
        raise InputError("The healthy runs hardly move the robot. Give longer ones.")
    return np.concatenate(parts), np.concatenate(clocks)


def _looks(known: Reference, gram: Array, clock: Array) -> Iterator[Looks]:
    """What windows of healthy runs say."""
    past = nothing(known.usual, gram.shape[-1], known.rules)
    for k in range(0, len(gram), 128):
        past, looks = follow(
            known.usual, known.rules, past, gram[k : k + 128], clock[k : k + 128]
        )
        yield looks
