"""A watch: a state and new samples in, the next state and alarms out.

A pure function, and one of the samples alone: the same samples in other batches give
the same alarms and the same state (tested with any cuts).
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from residual.epochs.rules import Watching
from residual.epochs.window import KINDS as OF_KIND
from residual.epochs.window import WAYS, Looks, Past, follow, nothing, products
from residual.errors import InputError, shown
from residual.monitoring.reference import (
    KINDS,
    LOAD,
    UNITS,
    Reference,
    packed,
    packed_fields,
    unpacked,
    unpacked_fields,
)
from residual.monitoring.rows import Heard, Pending, Rows, Samples, start, take
from residual.monitoring.rules import MONITOR
from residual.monitoring.usual import BLOCK
from residual.recording import Array

_AT_ONCE = 128  # bins


STATE_FORM = 2
_PLAIN = ("clock", "last", "left", "waited", "moved", "alarms")


@dataclass(frozen=True, eq=False, slots=True)
class State:
    """A stream at one moment."""

    tail: Pending  # of the samples
    rows: Rows  # rows in which a joint moves, of the bin that is not full yet
    use: Array  # where each joint of them counts. Shape (k, dof), bool
    clocks: Array  # time of each, gaps counted [s], (k,)
    since: Array  # rows since each joint stood, (dof,)
    past: Past  # sums of the bins before
    clock: float = 0.0  # time of the last row, gaps counted [s]
    # The same on the clock of the stream; NaN before the first [s].
    last: float = float("nan")
    left: int = 0  # bins of motion until the last alarm is over
    waited: int = 0  # bins that an alarm waits for its name
    moved: int = 0  # rows of motion so far
    alarms: int = 0  # how many there were


@dataclass(frozen=True, slots=True)
class Change:
    """An alarm: something is not as it was.

    Attributes:
        time: When it was raised, on the clock of the log [s].
        joint: Joint from 1; that of the flange for a load.
        quantity: load, gain, bias or friction.
        size: How large the change is, in `unit`.
        std: One standard deviation of it.
        unit: Unit of both.
        motion: Time of motion since the change began to show [s].
        score: Evidence over its limit, above 1.
        or_else: Other quantities that explain it at least half as well, each as
            quantity and joint, the best one first. No share of belief is given: what is
            watched is few of the things that may change.
        per_hour: How often chance alone would say this of a healthy arm; extrapolated
            beyond the healthy runs [1/h].
    """

    time: float
    joint: int
    quantity: str
    size: float
    std: float
    unit: str
    motion: float
    score: float
    or_else: tuple[tuple[str, int], ...]
    per_hour: float


def begin(reference: Reference) -> State:
    """Return the state before the first sample."""
    dof = reference.dof
    columns = 10 + reference.basis.shape[2]
    return State(
        tail=start(dof),
        rows=Rows.none(dof),
        use=np.empty((0, dof), bool),
        clocks=np.empty(0),
        since=np.zeros(dof, int),
        past=nothing(reference.usual, columns, reference.rules),
    )


def step(
    reference: Reference, state: State, samples: Samples
) -> tuple[State, tuple[Change, ...]]:
    """Look at new samples.

    Args:
        state: What was before; it stays as it is.
        samples: The new ones; none at all, or some without a number, are fine.

    Returns:
        The next state, and the alarms that the samples raise.

    Raises:
        InputError: If they have another number of joints.
    """
    if samples.q.shape[1:] != (reference.dof,) or samples.q.shape != samples.tau.shape:
        raise InputError(
            f"Samples with q of shape {samples.q.shape} and tau of "
            f"{samples.tau.shape}, expected {reference.dof} joints each."
        )
    tail, rows = take(state.tail, samples, reference.window)
    state = replace(state, tail=tail)
    changes: list[Change] = []
    state, bins = waited(reference, state, rows)
    for own, use, clock in bins:
        gram = products(reference.columns(own, use), reference.rules)
        past, looks = follow(reference.usual, reference.rules, state.past, gram, clock)
        times = own.t[reference.rules.rows - 1 :: reference.rules.rows]
        state, found = _alarms(reference, replace(state, past=past), looks, times)
        changes += found
    return replace(state, alarms=state.alarms + len(changes)), tuple(changes)


def waited(
    reference: Reference, state: State, rows: Rows
) -> tuple[State, Iterator[tuple[Rows, Array, Array]]]:
    """Put new rows to those that wait for a full bin.

    Returns:
        The state without rows of full bins; and these rows, some bins at once, where
        joints count in them, and the clock at the end of each bin.
    """
    if not len(rows.t):
        return state, iter(())
    slow = reference.is_slow(rows)
    use, since = usable(reference, slow, state.since)
    use &= ~reference.outside(rows)
    # Time of the rows since the stream began, without steps back [s].
    steps = np.diff(rows.t, prepend=rows.t[0] if np.isnan(state.last) else state.last)
    clocks = state.clock + np.cumsum(np.where(steps < 0, MONITOR.unknown, steps))
    moving = ~slow.all(axis=1)
    kept = Rows.joined([state.rows, rows[moving]])
    use = np.concatenate([state.use, use[moving]])
    ticks = np.concatenate([state.clocks, clocks[moving]])
    size = reference.rules.rows
    full = len(kept.t) // size * size
    state = replace(
        state,
        rows=kept[full:],
        use=use[full:],
        clocks=ticks[full:],
        since=since,
        clock=float(clocks[-1]),
        last=float(rows.t[-1]),
        moved=state.moved + int(moving.sum()),
    )
    many = _AT_ONCE * size
    cuts = [slice(i, min(i + many, full)) for i in range(0, full, many)]
    ends = [ticks[c][size - 1 :: size] for c in cuts]
    return state, ((kept[c], use[c], e) for c, e in zip(cuts, ends, strict=True))


def usable(reference: Reference, slow: Array, since: Array) -> tuple[Array, Array]:
    """Where joints have moved for a while, and for how many rows in the end.

    Shapes (m, dof) and (dof,) of ``slow`` and ``since``, those before.
    """
    memory = round(MONITOR.memory * reference.window.row_rate)
    number = np.arange(1, len(slow) + 1)[:, None]
    stood = np.maximum.accumulate(np.where(slow, number, -since), axis=0)
    moved = number - stood
    return moved > memory, np.minimum(moved[-1], memory + 1)


def _alarms(
    reference: Reference, state: State, looks: Looks, times: Array
) -> tuple[State, list[Change]]:
    """Which of some bins raise an alarm, and what it looks like.

    An alarm waits for its name to be sure, but not for long; where nothing is seen any
    more meanwhile it was none.
    """
    nats, rules = looks.nats(), reference.rules
    left, waited, found = state.left, state.waited, []
    crossed = (nats.max(axis=1) > reference.limits).any(axis=1)
    for k, hit in enumerate(crossed):
        left = max(left - 1, 0)
        if not hit:
            waited = 0
        elif left == 0 and waited < _patience(rules, nats[k]):
            waited += 1
        else:
            if left == 0:
                found.append(_change(reference, float(times[k]), looks, nats, k))
            left, waited = rules.quiet, 0
    return replace(state, left=left, waited=waited), found


def _patience(rules: Watching, nats: Array) -> int:
    """How many bins an alarm is to wait in all. Shape (w, h).

    Least where one name leads all others, where evidence is most; and shorter the
    longer the window that was needed.
    """
    best = int(nats.max(axis=1).argmax())
    each = np.sort(nats[best])
    least, part = rules.sure
    lead = each[-1] - each[-2] > max(least, part * each[-1])
    shorter = rules.patience[0] * (rules.windows[best] > rules.short)
    return rules.patience[0 if lead else 1] - shorter


def _change(
    reference: Reference, time: float, looks: Looks, nats: Array, k: int
) -> Change:
    """Name an alarm by what has most evidence, in the window where that is most."""
    w, h = np.unravel_index(int(nats[k].argmax()), nats[k].shape)
    each, rules = nats[k, w], reference.rules
    as_well = (i for i in np.argsort(-each) if each[i] > rules.as_well * each[h])
    highest = nats[k].max(axis=0)
    scores = highest / reference.limits
    worst = int(scores.argmax())
    name, joint = reference.watched[h]
    size, std = _size(reference, looks, (k, int(w)), int(h))
    since = int((nats[k, :, h] > rules.enough * nats[k, w, h]).argmax())
    chance = reference.tails[worst].chance(float(highest[worst]))
    return Change(
        time=time,
        joint=joint,
        quantity=name,
        size=size,
        std=std,
        unit=UNITS[name],
        motion=rules.windows[since] * rules.rows / reference.window.row_rate,
        score=float(scores[worst]),
        or_else=tuple(reference.watched[i] for i in as_well if i != h),
        per_hour=chance * 3600.0 / BLOCK,
    )


def _size(
    reference: Reference, looks: Looks, at: tuple[int, int], h: int
) -> tuple[float, float]:
    """Size of a change and its deviation, in its unit."""
    if reference.watched[h][0] == LOAD:
        theta, cov = looks.mass
        return float(theta[*at, 0]), float(np.sqrt(cov[*at, 0, 0]))
    j, kind = (h - 1) % reference.dof, (h - 1) // reference.dof
    ways = [i for i, own in enumerate(OF_KIND) if own == kind]
    columns = WAYS[max(ways, key=lambda i: looks.single[*at, j, i])]
    scale = np.ones(len(columns))
    if KINDS[kind] == "friction":
        scale = reference.friction[j, [max(c - 2, 0) for c in columns]]
    size = looks.size[*at, j, list(columns)] * scale
    std = looks.std[*at, j, list(columns)] * scale
    most = int(np.abs(size).argmax())
    return float(size[most]), float(std[most])


def state_to_record(state: State) -> dict:
    """Return the state of a stream."""
    return {
        "form": STATE_FORM,
        "kept": packed_fields(state.tail.kept),
        "in_piece": state.tail.count,
        "heard": asdict(state.tail.heard),
        "rows": packed_fields(state.rows),
        "past": packed_fields(state.past),
        **{name: packed(getattr(state, name)) for name in ("use", "clocks", "since")},
        **{name: getattr(state, name) for name in _PLAIN},
        "last": packed(np.array([state.last])),
    }


def state_from_record(record: Mapping) -> State:
    """Return the state of a record."""
    if record.get("form") != STATE_FORM:
        raise InputError(
            f"A state of form {shown(record.get('form'))}, expected {STATE_FORM}. "
            "Delete it to begin anew: healthy runs have to be learnt again."
        )
    try:
        heard = Heard(**record["heard"])
        tail = Pending(
            Samples(**unpacked_fields(record["kept"])), record["in_piece"], heard
        )
        plain = {name: record[name] for name in _PLAIN}
        return State(
            tail=tail,
            rows=Rows(**unpacked_fields(record["rows"])),
            past=Past(**unpacked_fields(record["past"])),
            **{name: unpacked(record[name]) for name in ("use", "clocks", "since")},
            **plain | {"last": float(unpacked(record["last"])[0])},
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"The state of the stream is damaged: {error}.") from error
