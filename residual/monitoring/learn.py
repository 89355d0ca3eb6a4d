"""Learn from healthy runs what is usual of an arm, and set limits.

The healthy runs are the first epoch: rows of all of them are fitted as those of
`diagnose --baseline` are, with all that any arm has a little of. Each run is then held
against what the others taught, window by window as it will be watched: by how much
windows differ beyond noise, and what evidence healthy ones show for changes that are
not there, of which `usual.tail_limit` makes limits.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects import registry
from residual.effects.base import Placed, Span
from residual.epochs.joint import Joint
from residual.epochs.rows import LOOSE, Layout, joint_fit
from residual.epochs.rules import Rules as EpochRules
from residual.epochs.rules import Watching
from residual.epochs.unrest import chosen
from residual.epochs.window import SLOW, Looks, Usual, follow, nothing, products
from residual.errors import InputError
from residual.evidence.design import LAGS
from residual.evidence.fit import as_model, autocorrelation_time
from residual.model.model import Model, Term
from residual.model.nominal import Logs, Nominal
from residual.monitoring.monitor import check_runs
from residual.monitoring.reference import Reference, body_sd, columns_of
from residual.monitoring.rows import Rows, Samples, Window, start, states_of, take
from residual.monitoring.rules import MONITOR
from residual.monitoring.usual import BLOCK, Tail, tail_limit, tail_of
from residual.monitoring.watch import begin, usable, waited
from residual.recording import Array, Recording
from residual.signals.track import Filters, Track

PER_HOUR = 0.1  # false alarms wanted at most, all quantities together
_AT_ONCE = 2048  # rows: what their columns take stays under 100 MB


def learn(
    model: Model,
    recordings: Sequence[Recording],
    per_hour: float = PER_HOUR,
    rules: Watching | None = None,
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
    rate = check_runs(model, recordings, per_hour)
    if Window(rate).half < 2:
        raise InputError(
            f"{recordings[0].id} is logged at {rate:g} Hz, expected at least 60 Hz."
        )
    samples = [Samples(run.t, run.q, run.tau) for run in recordings]
    begun, window = start(recordings[0].dof), Window(rate)
    runs = [take(begun, own, window)[1] for own in samples]
    bare = _bare(model, rate, rules or Watching(), runs)
    hours = sum(run.duration for run in recordings) / 3600.0
    bare = replace(bare, per_hour=per_hour, hours=hours)
    bare = replace(bare, model=fitted(bare, runs))
    taught = Taught.of(bare, runs)
    known = _with_noise(taught.reference(bare), taught, runs)
    return _with_limits(known, taught, runs)


def _bare(
    model: Model, rate: float, rules: Watching, runs: Sequence[Rows]
) -> Reference:
    """A reference that knows of the runs no more than their range.

    Its model is of single states: what remembers or needs a clock is usual.
    """
    kept = [t for t in model.terms if not (t.effect.remembers or t.effect.needs_clock)]
    plain = replace(model, terms=(*kept, *model.tables), tables=()).by_sign()
    dof, (lowest, highest) = model.robot.dof, _range(runs)
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
        theta=np.zeros((dof, 0)),
        basis=np.zeros((dof, 0, 0)),
        friction=np.ones((dof, 3)),
        usual=usual,
        limits=np.empty(0),
        tails=(),
        per_hour=0.0,
        hours=0.0,
        lowest=lowest,
        highest=highest,
        rules=rules,
    )


def _range(runs: Sequence[Rows], without: int | None = None) -> tuple[Array, Array]:
    """Lowest and highest q, qd and qdd of each joint that two runs have. (3, dof).

    Of all runs but one what one has: so no state is watched that none was left out of.
    """
    states = [states_of(r) for i, r in enumerate(runs) if i != without]
    k = 1 if without is None else 0
    lowest = np.sort([x.min(axis=0) for x in states], axis=0)[k]
    return lowest, np.sort([x.max(axis=0) for x in states], axis=0)[-1 - k]


class _Seen(Track):
    """Rows of a stream, which are filtered already, as a track."""

    __slots__ = ()

    def filter(self, columns: Array) -> Array:
        return columns


def fitted(bare: Reference, runs: Sequence[Rows]) -> Model:
    """One arm fitted to all runs as an epoch is, with what any arm has a little of.

    And with what single joints of this one have of the vocabulary, by pursuit.
    """
    logs = _logs(bare, runs)
    nominal = Nominal(bare.model, (None,) * len(bare.model.terms))
    joint = joint_fit(logs, nominal, (LOOSE,))
    model, design = as_model(nominal, joint.fitted), joint.design
    design.show_torque(model)
    wanted = [
        Placed(effect, on, shape)
        for effect in registry().values()
        if effect.scope == "local" and not (effect.remembers or effect.needs_clock)
        for on in effect.candidates(bare.dof)
        for shape in effect.shapes(logs.span, on[0])
    ]
    groups = design.add(wanted)
    usual = np.concatenate([design.nominal, *(g.ids for g in joint.known)])
    terms = []
    for j in range(bare.dof):
        shared = design.columns(j, design.present(j, usual)[0])
        rows = np.ones(len(shared), bool)
        target = design.residual(j, joint.fitted.ids, joint.fitted.theta)
        starts = np.zeros(1, int)
        layout = Layout(~rows, np.zeros(len(rows), int), starts, starts)
        alone = Joint(shared, target, layout, light=True)
        own = [g for g in groups if g.joints == (j,)]
        terms += chosen(design, j, own, rows, alone, EpochRules())
    more = [Term(g.effect, g.joints, g.shape, np.zeros(len(g.ids))) for g in terms]
    return replace(model, terms=(*model.terms, *more))


def _logs(bare: Reference, runs: Sequence[Rows]) -> Logs:
    """The runs as the logs of an epoch; of many rows some, evenly spread."""
    dof = bare.dof
    step = max(1, sum(len(r.t) for r in runs) // MONITOR.most_rows)
    rate = bare.window.row_rate / step
    tracks = []
    for i, whole in enumerate(runs):
        use, _ = usable(bare, bare.is_slow(whole), np.zeros(dof, int))
        rows, use = whole[::step], use[::step]
        tracks.append(
            _Seen(
                id=f"run {i}",
                rate=rate,
                t=np.arange(len(rows.t)) / rate,
                q=rows.q,
                qd=rows.qd,
                qdd=rows.qdd,
                cutoff=0.25 * bare.window.row_rate,
                step=1,
                tau=rows.tau,
                inner=np.ones(len(rows.t), bool),
                moving=use,
                torque_noise=np.zeros(dof),
            )
        )
    moving = np.sum([t.moving.sum(axis=0) for t in tracks], axis=0)
    if (moving < LAGS).any():
        raise InputError(
            f"Joint {int(moving.argmin()) + 1} hardly moves in the healthy runs. Give "
            "runs that move it."
        )
    every = Rows.joined(runs)
    span = Span(
        speed=np.quantile(np.abs(every.qd), 0.95, axis=0),
        travel=np.ptp(every.q, axis=0),
        duration=0.0,
        cutoff=0.25 * bare.window.row_rate,
        torque=np.quantile(np.abs(every.tau), 0.995, axis=0),
    )
    floor, robot = bare.model.speed_floor, bare.model.robot
    return Logs(robot, tuple(tracks), None, span, floor, Filters(), ())


@dataclass(frozen=True, eq=False, slots=True)
class Taught:
    """Normal equations of each run, joint by joint."""

    use: tuple[Array, ...]  # where joints of each run count, (m, dof)
    gram: Array  # products of the columns, (runs, dof, p, p)
    cross: Array  # those with what the fit of all leaves, (runs, dof, p)
    power: Array  # squares of that [N^2 m^2], (runs, dof)
    rows: Array  # rows of each joint, (runs, dof)
    torque: Array  # squares of the torque on them, (runs, dof)
    size: Array  # squares of friction, its dry part and speed on them, (runs, dof, 3)
    free: float  # deviation of torque that a column may have [1]: of rms

    @classmethod
    def of(cls, bare: Reference, runs: Sequence[Rows]) -> "Taught":
        """Add up the rows of each run."""
        sums, use = [], []
        for rows in runs:
            moves, _ = usable(bare, bare.is_slow(rows), np.zeros(bare.dof, int))
            use.append(moves)
            parts = [
                _normal(bare, rows[i : i + _AT_ONCE], moves[i : i + _AT_ONCE])
                for i in range(0, len(rows.t), _AT_ONCE)
            ]
            sums.append([sum(own) for own in zip(*parts, strict=True)])
        every = [np.array(own) for own in zip(*sums, strict=True)]
        return cls(tuple(use), *every, free=bare.rules.free)

    @property
    def rms(self) -> Array:
        """Torque of each joint [N m]. Shape (dof,)."""
        rows = np.maximum(self.rows.sum(axis=0), 1.0)
        return np.maximum(np.sqrt(self.torque.sum(axis=0) / rows), 1e-9)

    def fit(self, without: int = -1) -> tuple[Array, Array, Array]:
        """Fit each joint to all runs but one.

        Returns:
            Coefficients beyond those of the model, shape (dof, p); their posterior
            covariance over the noise of independent rows, (dof, p, p); and the sizes
            of columns, (dof, p).
        """
        used = [i for i in range(len(self.gram)) if i != without]
        gram, cross = self.gram[used].sum(axis=0), self.cross[used].sum(axis=0)
        rows = np.maximum(self.rows[used].sum(axis=0), 1.0)[:, None]
        size = np.sqrt(np.einsum("jpp->jp", gram) / rows)
        size = np.maximum(size, 1e-9 * size.max())
        left = self.power[used].sum(axis=0) / rows[:, 0]
        left = left + (MONITOR.floor * self.rms) ** 2
        held = left / (self.free * self.rms) ** 2
        inner = gram / (size[:, :, None] * size[:, None, :])
        inner = inner + held[:, None, None] * np.eye(gram.shape[-1])
        inverse = np.linalg.inv(inner)
        theta = (inverse @ (cross / size)[..., None])[..., 0] / size
        return theta, inverse, size

    def reference(self, bare: Reference) -> Reference:
        """What all runs teach, but for noise and limits.

        Directions are told by the torque that a column of each may have; those that no
        motion shows (bodies whose torques are one) are none.
        """
        theta, inverse, size = self.fit()
        rows = np.maximum(self.rows.sum(axis=0), 1.0)[:, None, None]
        outer = size[:, :, None] * size[:, None, :]
        values, vectors = np.linalg.eigh(self.gram.sum(axis=0) / outer / rows)
        least = MONITOR.real * values.max(axis=-1, keepdims=True)
        real = vectors * (values > least)[:, None]
        seen = real @ np.swapaxes(real, -1, -2)
        values, vectors = np.linalg.eigh(seen @ inverse @ seen)
        most = bare.rules.uncertain
        values, vectors = values[:, ::-1][:, :most], vectors[:, :, ::-1][:, :, :most]
        basis = vectors * np.sqrt(np.maximum(values, 0.0))[:, None]
        friction = np.sqrt(self.size.sum(axis=0) / rows[..., 0])
        return replace(
            bare, theta=theta, basis=basis / size[..., None], friction=friction
        )


def _normal(bare: Reference, rows: Rows, use: Array) -> tuple[Array, ...]:
    """Products of the columns of some rows, joint by joint."""
    made = columns_of(bare.model, rows)
    x = (made.x * use[..., None]).transpose(1, 0, 2)
    left = ((rows.tau - made.expected) * use).T
    braking = made.x @ (made.braking * made.base)
    size = np.stack([braking, made.sign, rows.qd], axis=-1) * use[..., None]
    return (
        np.swapaxes(x, 1, 2) @ x,
        (left[:, None] @ x)[:, 0],
        (left**2).sum(axis=1),
        use.sum(axis=0).astype(float),
        ((rows.tau * use) ** 2).sum(axis=0),
        (size**2).sum(axis=0),
    )


def _left_out(
    known: Reference, taught: Taught, runs: Sequence[Rows]
) -> Iterator[tuple[Array, Array]]:
    """Columns of each run by what the others taught, and where joints count."""
    for i, rows in enumerate(runs):
        lowest, highest = _range(runs, i)
        own = replace(known, theta=taught.fit(i)[0], lowest=lowest, highest=highest)
        use = taught.use[i] & ~own.outside(rows)
        parts = [
            own.columns(rows[k : k + _AT_ONCE], use[k : k + _AT_ONCE])
            for k in range(0, len(rows.t), _AT_ONCE)
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
        size = 1 + np.trace(gram, axis1=1, axis2=2)
        gram = gram + 1e-6 * np.eye(SLOW) * size[:, None, None]
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
    # Coefficients of changes of usual size on each joint. Shape (dof, 5).
    size, rms = np.maximum(known.friction, 1e-9), taught.rms
    all_of_it, dry, viscous = (rms / size[:, i] for i in range(3))
    single = np.column_stack([all_of_it, rms, np.ones(dof), dry, viscous])
    own = {"noise": noise, "slow": slow, "quick": quick}
    usual = replace(known.usual, **own, single=MONITOR.usual * single)
    basis = known.basis * np.sqrt(noise)[:, None, None]
    return replace(known, basis=basis, usual=usual)


def _between(
    rules: Watching, taught: Taught, noise: Array, means: Array, infos: Array
) -> tuple[Array, Array]:
    """Deviation of the slow between runs, and with the motion. Shapes (dof, 2).

    Beyond noise. Runs that follow each other are as warm: what they differ by is that
    of their motions.
    """
    chance = np.einsum("rjaa->rja", np.linalg.inv(infos)) * noise[:, None]
    told = chance < 0.25 * np.maximum(means**2, chance.min(axis=0))
    squares = np.where(told, means**2 - chance, np.nan)
    most = np.nansum(squares, axis=0) / np.maximum(told.sum(axis=0), 1)
    warmth = np.full(len(noise), rules.warmth)
    least = np.column_stack([warmth, rules.offset * taught.rms])
    # One run of many that is cold makes the tail.
    far = MONITOR.largest * np.abs(np.where(told, means, 0.0)).max(axis=0)
    slow = np.maximum.reduce([np.sqrt(np.maximum(most, 0.0)), far, least])
    steps = np.quantile(np.abs(np.diff(means, axis=0)), 0.8, axis=0) / MONITOR.steps
    own = np.sqrt(np.maximum(steps**2 - np.median(chance, axis=0), 0.0))
    return slow, np.clip(own, rules.quick * slow, slow)


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
