"""The second epoch as a sliding window: what changed within the last rows of an arm.

The first epoch is the healthy runs that taught the arm; the second the rows of the last
seconds of motion. Of each joint's rows in a window the first epoch expects

    r = U u + S m + C theta + e,   u ~ N(0, 1),  m ~ N(m0, P),  e ~ N(0, noise 1)

with r what its fit leaves of the torque, U the directions of the nuisance that the
healthy runs left uncertain, S what any arm does slowly (all friction of the joint as
one column, as it warms, and a constant) and C theta the change. By Woodbury only
products of these columns are needed, and those of short bins add up to windows of any
length (METHOD section 13). What S does is followed by a Kalman filter from bin to bin;
a window is judged by what was known of it where the window begins, so that no step is
taken for warmth before it was looked at.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.epochs.contrast import worth_of
from residual.epochs.rules import Watching
from residual.recording import Array

SLOW = 2  # columns of what any arm does slowly: friction, constant
COURSE = [
    0,
    2,
    1,
]  # friction, constant, course of friction: of their levels and courses
BODY = 4  # columns of a load: mass and first moments
SINGLE = 5  # columns of one joint: friction, constant, gain, dry and viscous friction
# What may change on one joint, by these columns, and which quantity each is.
FRICTION, BIAS, GAIN = 0, 1, 2
WAYS = ((0,), (1,), (2,), (3,), (4,), (3, 4))
KINDS = (FRICTION, BIAS, GAIN, FRICTION, FRICTION, FRICTION)
QUANTITIES = 3


@dataclass(frozen=True, eq=False, slots=True)
class Usual:
    """What the first epoch says of the second, without a change."""

    # Variance of rows, times the rows that are as good as one [N^2 m^2], (dof,).
    noise: Array
    # By how much windows differ beyond that, as a factor on deviations, by length of
    # window, (windows, dof).
    unrest: Array
    # Deviation of friction, as a share, and of the constant [N m], between runs, (dof,
    # 2).
    slow: Array
    quick: Array  # what of that goes with the motion, (dof, 2)
    body: Array  # prior deviation of mass [kg] and first moments [kg m], (4,)
    single: Array  # the same of changes of one joint, as in KINDS, (dof, 5)

    @property
    def prior(self) -> Array:
        """Covariance of the slow and of its course, before anything is known of them.

        Shape (dof, 4, 4): friction, its course, constant, its course.
        """
        return np.repeat(self.slow, 2, axis=1)[:, :, None] ** 2 * np.eye(2 * SLOW)

    def cold(self, rules: Watching) -> Array:
        """The same behind a longer pause. Shape (dof, 4, 4)."""
        course = np.array([1.0, rules.fresh] * SLOW)
        return self.prior * np.outer(course, course)

    def scaled(self, gram: Array) -> Array:
        """Products over the noise. Shape as given, (..., dof, f, f)."""
        return gram / self.noise[:, None, None]


@dataclass(frozen=True, eq=False, slots=True)
class Past:
    """Sums of the last bins, and what was known of the slow where each begins."""

    gram: Array  # products of all columns in each bin, (b, dof, f, f)
    # Of the slow and its course (``Usual.prior``), behind each bin, (b, dof, 4), (b,
    # dof, 4, 4).
    mean: Array
    cov: Array
    clock: Array  # time behind each bin, gaps counted [s], (b,)

    def __getitem__(self, rows: slice) -> "Past":
        return Past(self.gram[rows], self.mean[rows], self.cov[rows], self.clock[rows])


@dataclass(frozen=True, eq=False, slots=True)
class Looks:
    """What windows that end with each of some bins say; n bins, w windows."""

    load: Array  # evidence for a load [nats], (n, w)
    single: Array  # the same for changes of one joint, by WAYS, (n, w, dof, 6)
    # Coefficients of the load and their covariance. (n, w, 4), (n, w, 4, 4).
    mass: tuple[Array, Array]
    # Coefficient and deviation of each column, (n, w, dof, 5).
    size: Array
    std: Array
    squares: Array  # squares of these as standard normal variables, (n, w, dof, 5)

    def nats(self) -> Array:
        """Evidence by quantity: load, then friction, bias, gain of each joint.

        Shape (n, w, 1 + 3 dof).
        """
        by_kind = [
            self.single[..., [i for i, own in enumerate(KINDS) if own == kind]].max(-1)
            for kind in range(QUANTITIES)
        ]
        return np.concatenate([self.load[..., None], *by_kind], axis=-1)


def nothing(usual: Usual, columns: int, rules: Watching) -> Past:
    """Return the past before the first row: empty bins, an unknown slow state."""
    dof, b = len(usual.noise), rules.longest
    return Past(
        np.zeros((b, dof, columns, columns)),
        np.zeros((b, dof, 2 * SLOW)),
        np.tile(usual.cold(rules), (b, 1, 1, 1)),
        np.full(b, -np.inf),
    )


def products(columns: Array, rules: Watching) -> Array:
    """Return products of columns, those of whole bins. (m, dof, f) to (b, dof, f, f).

    The columns of a row are r, U, S, those of a load, and gain, dry and viscous
    friction; all are 0 where a joint does not count.
    """
    m, dof, f = columns.shape
    parts = columns.reshape(m // rules.rows, rules.rows, dof, f).transpose(0, 2, 1, 3)
    return parts.transpose(0, 1, 3, 2) @ parts


def follow(
    usual: Usual, rules: Watching, past: Past, gram: Array, clock: Array
) -> tuple[Past, Looks]:
    """Look at new bins.

    Args:
        gram: Products of the new bins, in order. Shape (n, dof, f, f).
        clock: Time at the end of each [s]. Shape (n,).

    Returns:
        What is past then, and what the windows that end with each bin say.
    """
    mean, cov = _followed(usual, rules, past, gram, clock)
    grown = Past(
        np.concatenate([past.gram, gram]),
        np.concatenate([past.mean, mean]),
        np.concatenate([past.cov, cov]),
        np.concatenate([past.clock, clock]),
    )
    n, longest = len(gram), rules.longest
    total = np.concatenate([np.zeros((1, *gram.shape[1:])), grown.gram.cumsum(axis=0)])
    ends = longest + np.arange(n)  # numbers of the new bins
    # No window looks back over a longer pause: behind it an arm is another.
    number = np.arange(longest + n)
    before = np.maximum(np.concatenate([[-np.inf], grown.clock[:-1]]), -1e12)
    paused = np.maximum(grown.clock, -1e12) - before > rules.pause
    pause = np.maximum.accumulate(np.where(paused, number - 1, -1))
    windows: list[tuple[Array, ...]] = []
    for length in rules.windows:
        begins = np.maximum(ends - length, pause[ends])  # the last bin before each
        sums = _with_course(total[ends + 1] - total[begins + 1], rules, grown, begins)
        before = np.maximum(begins, 0)
        known = grown.mean[before], grown.cov[before]
        # As it is in the middle of the window.
        since = grown.clock[ends] - grown.clock[before]
        since = np.where(since > rules.pause, np.inf, 0.5 * since)
        windows.append((sums, *_later(usual, rules, known, since)))
    sums, mean, cov = (np.stack(x, axis=1) for x in zip(*windows, strict=True))
    mean, cov = mean[..., COURSE], cov[..., COURSE, :][..., COURSE]
    quick = np.zeros((len(usual.noise), SLOW + 1))
    quick[:, :SLOW] = usual.quick
    cov = cov + quick[..., None] ** 2 * np.eye(SLOW + 1)
    return grown[len(grown.gram) - longest :], _looks(usual, sums, mean, cov)


def _with_course(sums: Array, rules: Watching, grown: Past, begins: Array) -> Array:
    """Products of windows with one more column: friction by the time in the window.

    Args:
        sums: Products in the windows that end with each new bin. Shape (n, dof, f, f).
        begins: Number of the last bin before each window. Shape (n,).

    Returns:
        The same with that column behind the slow. Shape (n, dof, f + 1, f + 1).
    """
    n, f = len(sums), sums.shape[-1]
    at = _slow(f)
    ends = len(grown.clock) - n + np.arange(n)
    length = int((ends - begins).max())
    bins = np.maximum(ends[:, None] - np.arange(length)[::-1], 0)  # (n, length)
    inside = bins > begins[:, None]
    first = grown.clock[np.minimum(begins + 1, ends)][:, None]
    middle = 0.5 * (first + grown.clock[ends][:, None])
    time = np.where(inside, grown.clock[bins], middle) - middle
    time = np.sqrt(3) / rules.memory * time
    rows = grown.gram[bins, :, at.start]  # (n, length, dof, f)
    cross = np.einsum("nljf,nl->njf", rows, time)
    square = np.einsum("nlj,nl->nj", rows[..., at.start], time**2)
    out = np.zeros((*sums.shape[:2], f + 1, f + 1))
    old = [*range(at.stop), *range(at.stop + 1, f + 1)]
    out[..., np.array(old)[:, None], old] = sums
    out[..., at.stop, old] = out[..., old, at.stop] = cross
    out[..., at.stop, at.stop] = square
    return out


def _later(usual: Usual, rules: Watching, known, seconds: Array) -> tuple[Array, Array]:
    """What is known of the slow some time later: it keeps its course for a while.

    A Matern process of order 3/2, level and rate in units of one deviation each.
    Shapes (n, dof, 4), (n, dof, 4, 4) and (n,).
    """
    mean, cov = known
    apart = seconds > rules.pause
    mean = np.where(apart[:, None, None], 0.0, mean)
    cov = np.where(apart[:, None, None, None], usual.cold(rules), cov)
    seconds = np.where(apart, 0.0, seconds)
    x = np.clip(np.sqrt(3) * seconds / rules.memory, 0.0, 60.0)
    own = np.array([[1 + x, x], [-x, 1 - x]]) * np.exp(-x)
    turn = np.zeros((len(x), 1, 2 * SLOW, 2 * SLOW))
    for i in range(0, 2 * SLOW, 2):
        turn[:, 0, i : i + 2, i : i + 2] = own.transpose(2, 0, 1)
    back = np.swapaxes(turn, -1, -2)
    mean = (turn @ mean[..., None])[..., 0]
    return mean, turn @ (cov - usual.prior) @ back + usual.prior


def _followed(
    usual: Usual, rules: Watching, past: Past, gram: Array, clock: Array
) -> tuple[Array, Array]:
    """Mean and covariance of the slow behind each new bin: a Kalman filter."""
    at = _slow(gram.shape[-1])
    free = np.eye(at.start - 1)
    info, pull = _left(usual.scaled(gram), free, range(at.start, at.stop))
    # Windows of a middle length say by how much bins differ beyond noise.
    unrest = usual.unrest[len(usual.unrest) // 2][:, None, None] ** 2
    info, pull = info / unrest, pull[..., None] / unrest
    wide = np.zeros((*info.shape[:2], 2 * SLOW, 2 * SLOW))
    wide[..., ::2, ::2] = info
    far = np.zeros((*info.shape[:2], 2 * SLOW, 1))
    far[..., ::2, :] = pull
    mean, cov, before = past.mean[-1:], past.cov[-1:], past.clock[-1]
    means, covs = [], []
    for k, now in enumerate(clock):
        mean, cov = _later(usual, rules, (mean, cov), np.array([now - before]))
        precision = np.linalg.inv(cov[0])
        own = np.linalg.inv(precision + wide[k])
        mean = (own @ (precision @ mean[0][..., None] + far[k]))[None, ..., 0]
        cov, before = own[None], now
        means.append(mean)
        covs.append(cov)
    return np.concatenate(means), np.concatenate(covs)


def _slow(columns: int) -> slice:
    """Where the slow stand among so many columns: r, U, S, a load, one joint."""
    start = columns - SINGLE - BODY
    return slice(start, start + SLOW)


def _left(gram: Array, precision: Array, what: Sequence[int]) -> tuple[Array, Array]:
    """Information and pull of columns beside the nuisance, which has a prior.

    Args:
        gram: Products over the noise. Shape (..., f, f).
        precision: Of the first columns behind r. Shape (..., k, k).

    Returns:
        Shapes (..., c, c), (..., c).
    """
    size, what = precision.shape[-1] + 1, np.asarray(what)
    cross = gram[..., 1:size, :][..., np.append(what, 0)]
    turn = np.linalg.solve(gram[..., 1:size, 1:size] + precision, cross)
    rest = np.swapaxes(cross[..., :-1], -1, -2) @ turn
    kept = gram[..., what[:, None], what] - rest[..., :-1]
    return kept, gram[..., what, 0] - rest[..., -1]


def _looks(usual: Usual, gram: Array, mean: Array, cov: Array) -> Looks:
    """What windows say.

    Args:
        gram: Products, with the course of friction. Shape (n, w, dof, f + 1, f + 1).
        mean: Of the slow and that course. Shape (n, w, dof, 3).
        cov: Of these. Shape (n, w, dof, 3, 3).
    """
    many = mean.shape[-1]
    start = _slow(gram.shape[-1] - 1).start
    stop = start + many
    # Less the slow as it is expected.
    known = (gram[..., start:stop] @ mean[..., None])[..., 0]
    gram = gram.copy()
    gram[..., 0] -= known
    precision = np.zeros((*gram.shape[:-2], stop - 1, stop - 1))
    every = np.arange(stop - 1)
    precision[..., every, every] = 1.0
    precision[..., start - 1 :, start - 1 :] = np.linalg.inv(cov)
    what = [*range(stop, stop + BODY), start, start + 1]
    what += range(stop + BODY, gram.shape[-1])
    info, pull = _left(usual.scaled(gram), precision, what)
    unrest = usual.unrest[..., None] ** 2
    info, pull = info / unrest[..., None], pull / unrest
    alone = np.arange(BODY, BODY + SINGLE)
    load, mass = _of_load(usual, info[..., :BODY, :BODY], pull[..., :BODY])
    own, pulled = np.maximum(info[..., alone, alone], 0.0), pull[..., alone]
    prior = 1 / usual.single**2
    nats = [
        _evidence(info[..., BODY:, BODY:], pull[..., BODY:], prior, list(way))
        for way in WAYS
    ]
    std = 1 / np.sqrt(own + prior)
    squares = pulled**2 / np.maximum(own, 1e-300)
    enough = own > prior  # the window says more of it than was known
    return Looks(
        load=load,
        single=np.stack(nats, axis=-1),
        mass=mass,
        size=pulled * std**2,
        std=std,
        squares=np.where(enough, squares, np.nan),
    )


def _evidence(info: Array, pull: Array, prior: Array, way: list[int]) -> Array:
    """Evidence for some columns of each joint together. Shape (n, w, dof)."""
    info = info[..., way, :][..., way]
    info = 0.5 * (info + np.swapaxes(info, -1, -2))
    own = prior[:, way, None] * np.eye(len(way))
    return worth_of(info, pull[..., way], np.broadcast_to(own, info.shape), None)


def _of_load(usual: Usual, info: Array, pull: Array):
    """Evidence for a load on all joints together, its coefficients and covariance."""
    info, pull = info.sum(axis=-3), pull.sum(axis=-2)
    info = 0.5 * (info + np.swapaxes(info, -1, -2))
    prior = np.diag(1 / usual.body**2)
    cov = np.linalg.inv(info + prior)
    nats = worth_of(info, pull, np.broadcast_to(prior, info.shape), None)
    return nats, ((cov @ pull[..., None])[..., 0], cov)
