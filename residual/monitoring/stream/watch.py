"""The stream: a state and new samples in, the next state and alarms out.

A pure function, and one of the samples alone: the same samples in other batches give
the same alarms and the same state (tested with any cuts).
"""

from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError
from residual.monitoring.stream.cusum import page, whiten
from residual.monitoring.stream.reference import Reference
from residual.monitoring.stream.rows import Rows, Samples, Tail, start, take
from residual.monitoring.stream.seen import features
from residual.monitoring.usual import BLOCK
from residual.recording import Array

QUIET = 10.0  # s of motion without a crossing after which an alarm is over
REMEMBERED = 15.0  # s of motion: slower changes are those of warmth
AS_WELL = 0.5  # of the evidence of the best: what else it may be
MEMORY = 0.1  # s after standing in which friction is not to be trusted
# Of the smallest size; larger ones know better when a large change began.
_WAYS = np.array([1.0, -1.0, 3.0, -3.0, 9.0, -9.0])


@dataclass(frozen=True, slots=True)
class Change:
    """An alarm: something is not as it was.

    Attributes:
        time: When it was raised, on the clock of the log [s].
        joint: Joint from 1; that of the flange for a load.
        quantity: load, gain, bias or friction.
        size: How large the change is, in `unit`.
        std: One standard deviation of it, widened by what healthy runs scatter.
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


@dataclass(frozen=True, eq=False, slots=True)
class State:
    """All that a stream has to know of what was before.

    Attributes:
        tail: Of the samples.
        lags: The last rows, the latest first. Shape (p, dof, 5).
        count: Rows in this piece.
        rest: Rows that each joint is still not to be trusted. Shape (dof,), int.
        slow: What the last seconds of motion say of each quantity (`cusum.page`).
            Shape (h, 2).
        g: Evidence for changes of each quantity, by size and sign. Shape (h, 6).
        sums: What sizes are made of (`cusum.page`). Shape (h, 6, 3).
        left: Rows of motion until the last alarm is over.
        moved: Rows of motion so far.
        alarms: How many there were.
    """

    tail: Tail
    lags: Array
    count: int
    rest: Array
    slow: Array
    g: Array
    sums: Array
    left: int = 0
    moved: int = 0
    alarms: int = 0


@dataclass(frozen=True, eq=False, slots=True)
class Evidence:
    """What rows say, white and in standard deviations; 0 where it does not count.

    Attributes:
        z: Residual. Shape (m, dof).
        u: Features of load, gain, bias and friction. Shape (m, dof, 4).
        moving: A joint moves. Shape (m,), bool.
    """

    z: Array
    u: Array
    moving: Array

    @property
    def products(self) -> tuple[Array, Array]:
        """Sums u z and u^2 of each quantity over its joints. Shapes (m, h)."""
        return tuple(map(_by_quantity, (self.u * self.z[..., None], self.u**2)))


def _by_quantity(parts: Array) -> Array:
    """A load is felt by all joints, the rest by one each. (m, dof, 4) to (m, h)."""
    local = np.moveaxis(parts[..., 1:], 2, 1).reshape(len(parts), -1)
    return np.column_stack([parts[..., 0].sum(axis=1), local])


def begin(reference: Reference) -> State:
    """Return the state before the first sample."""
    dof, many = reference.dof, len(reference.sizes)
    return State(
        tail=start(dof),
        lags=np.zeros((len(reference.filters), dof, 5)),
        count=0,
        rest=np.zeros(dof, dtype=np.int64),
        slow=np.zeros((many, 2)),
        g=np.zeros((many, len(_WAYS))),
        sums=np.zeros((many, len(_WAYS), 3)),
    )


def step(
    reference: Reference, state: State, samples: Samples
) -> tuple[State, tuple[Change, ...]]:
    """Look at new samples.

    Args:
        reference: What is usual.
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
    if not len(rows.t):
        return state, ()
    state, seen = evidence(reference, state, rows)
    state, found, _ = add_up(reference, state, seen, reference.limits)
    changes = tuple(_change(reference, rows.t[k], g, s) for k, g, s in found)
    return replace(state, alarms=state.alarms + len(changes)), changes


def evidence(reference: Reference, state: State, rows: Rows) -> tuple[State, Evidence]:
    """Return what rows say, whitened and in standard deviations.

    Returns:
        The state behind them, and the evidence.
    """
    x, slow = features(reference.model, rows, reference.load)
    apart = slow | reference.outside(rows)
    lags, rest = state.lags.copy(), state.rest.copy()
    memory = round(MEMORY * reference.window.row_rate)
    carried = (lags, rest, state.count)
    white, use, count = whiten(
        x, apart, rows.begins, reference.filters, memory, carried
    )
    white *= (use / reference.sigma)[..., None]
    white[..., 1] *= reference.felt
    found = Evidence(white[..., 0], white[..., 1:], ~slow.all(axis=1))
    return replace(state, lags=lags, rest=rest, count=count), found


def add_up(
    reference: Reference,
    state: State,
    seen: Evidence,
    limits: Array,
) -> tuple[State, list[tuple[int, Array, Array]], Array]:
    """Add up evidence for each quantity, and say where it passes its limit.

    Args:
        reference: What is usual.
        state: The state behind the rows.
        seen: Of `evidence`.
        limits: Limit of each quantity. Shape (h,).

    Returns:
        The next state; row, sums and their parts of each alarm; all sums, shape
        (m, h, 6).
    """
    slow, g, sums = state.slow.copy(), state.g.copy(), state.sums.copy()
    rate = reference.window.row_rate
    levels = np.array([limits, reference.prior, reference.usual])
    settings = (levels, 1.0 / (REMEMBERED * rate), round(QUIET * rate))
    rows = tuple(map(np.ascontiguousarray, (seen.z, seen.u, seen.moving * 1.0)))
    trace, at, each, details, left = page(
        rows, reference.sizes[:, None] * _WAYS, settings, (slow, g, sums, state.left)
    )
    moved = state.moved + int(seen.moving.sum())
    made = replace(state, slow=slow, g=g, sums=sums, left=int(left), moved=moved)
    return made, list(zip(map(int, at), each, details, strict=True)), trace


def _change(reference: Reference, time: float, g: Array, sums: Array) -> Change:
    """Name an alarm by the quantity that explains most, whichever passed its limit.

    Each with the size that explains most: over^2 / (2 under), in units of what healthy
    runs scatter (the generalised likelihood ratio: Basseville & Nikiforov 1993, section
    2.4.3).
    """
    spread = np.maximum(1.0, [tail.beta for tail in reference.tails])
    under = np.where(sums[..., 1] > 0, sums[..., 1], np.inf)
    told = np.where(g > 0, sums[..., 0] ** 2 / (2 * under), 0.0) / spread[:, None]
    h, way = np.unravel_index(int(told.argmax()), told.shape)
    each = told.max(axis=1)
    others = [i for i in np.argsort(-each) if i != h and each[i] > AS_WELL * each[h]]
    worst = int((g.max(axis=1) / reference.limits).argmax())
    top = float(g[worst].max())
    quantity = reference.watched[h]
    return Change(
        time=float(time),
        joint=quantity.joint,
        quantity=quantity.name,
        size=float(sums[h, way, 0] / under[h, way]),
        std=float(np.sqrt(spread[h] / under[h, way])),
        unit=quantity.unit,
        motion=float(sums[h, way, 2] / reference.window.row_rate),
        score=top / float(reference.limits[worst]),
        or_else=tuple(
            (reference.watched[i].name, reference.watched[i].joint) for i in others
        ),
        per_hour=reference.tails[worst].chance(top) * 3600.0 / BLOCK,
    )
