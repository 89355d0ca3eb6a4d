"""Would another experiment settle the open question? A bound, without designing one.

Motions without obstacles, each joint through its full range at its limits, show the
largest possible separation of the rivals. An arm in its cell can do less, and a designed
motion separates better than a random one: see `modelgap next`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from residual.effects.base import PlacedEffect, State
from residual.model.model import Model
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.track import dilate_mask
from residual.verdict.result import NOTHING, SURE, TOGETHER, UNTOLD, Alternative, Place

# The open question of some logs: contests of rival models, as records.


@dataclass(frozen=True, eq=False, slots=True)
class Rival:
    """One model that may be true, as a Gaussian over coefficients of shared columns."""

    place: Place  # the effect that differs, `NOTHING` for none
    columns: Array  # its indices among the shared columns, (k,)
    effect_columns: Array  # positions of the effect's columns among these; empty for none, (e,)
    mean: Array  # their posterior mean [SI], (k,)
    precision: Array  # their posterior precision, (k, k)
    # Evidence of the logs so far, less the price of the name [nats], up to a constant
    # common to all rivals of a contest.
    nats: float


@dataclass(frozen=True, eq=False, slots=True)
class RivalContest:
    """Rival models, one of which is true."""

    rivals: tuple[Rival, ...]  # two or more
    enough: float  # lead in nats that decides

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Every ordered pair of rivals: the true one first."""
        return tuple(permutations(range(len(self.rivals)), 2))

    def lead(self, a: int, b: int) -> float:
        """Lead of one rival over another by the logs so far [nats]."""
        return self.rivals[a].nats - self.rivals[b].nats


@dataclass(frozen=True, eq=False, slots=True)
class SignalSettings:
    """Signal settings of the logs so far, and of the next one."""

    information: Array  # of a row's squared error [1 / N^2 m^2], (dof,)
    speed_floor: Array  # speed below which a joint stands [rad/s], (dof,)
    rate: float  # rows per second [Hz]
    margin: float  # masked time around a standstill [s]
    edge: float  # time at both ends of a log that does not count [s]
    start: float  # session time at which the next log may begin [s]


@dataclass(frozen=True, eq=False, slots=True)
class OpenQuestion:
    """The open question of the logs so far."""

    nominal: Model  # the model at zero deviation
    seen_with: Model  # the model whose torque the effects depend on
    effects: tuple[PlacedEffect, ...]  # columns after the inertial ones
    signals: SignalSettings
    contests: tuple[RivalContest, ...]  # empty if nothing is open


def merge_places(places: Sequence[Place]) -> Place:
    """The name of a rival: that of its effect, or of several together."""
    if not places:
        return NOTHING
    joints = sorted({j for place in places for j in place.joints})
    return Place(TOGETHER.join(place.name for place in places), tuple(joints))


# The expected result of a motion for a question: nats for every pair, chance, seconds.
#
# Each rival predicts new whitened rows y: y ~ N(X mu, I + X S X'), with mu and S its
# posterior after the logs so far and X its columns on the new motion. Everything follows
# from G = X' X of the shared columns, by the matrix inversion lemma.
#
# The criterion for A against B is the expected log Bayes factor of a log with A true at
# its identified size mu. Its quadratic part is the T-criterion of Atkinson & Fedorov 1975,
# with B refitted under its posterior. The average over the uncertainty of A (the
# Kullback-Leibler divergence, Box & Hill 1967, eq. 3.6) is not used: the few largest sizes
# that the logs so far allow dominate it. The uncertainty of A enters the chance, which is
# counted in simulated logs.


DRAWS = 400  # number of simulated logs for a chance
HOPELESS = 1 / 6  # of the needed evidence: less decides nothing
Pair = tuple[int, int, int]  # contest, true rival, other rival


@dataclass(frozen=True, eq=False, slots=True)
class RivalUpdate:
    """A rival after new rows, scaled so that its posterior precision has ones."""

    rival: Rival
    scale: Array  # standard deviations by which coefficients are scaled, (k,)
    factor: Array  # lower Cholesky factor of precision + G, scaled, (k, k)
    log_det: float  # ln det(precision + G) - ln det(precision)
    learned: float  # effective number of parameters of the new rows, tr((precision + G)^-1 G)

    @classmethod
    def of(cls, rival: Rival, gram: Array) -> "RivalUpdate":
        """Factor once for the Gram matrix of a motion, (m, m)."""
        scale = 1 / np.sqrt(np.diag(rival.precision))
        both = np.outer(scale, scale)
        known = rival.precision * both
        own = gram[np.ix_(rival.columns, rival.columns)]
        factor = cho_factor(known + own * both, lower=True)[0]
        log_det = 2 * np.log(np.diag(factor)).sum() - np.linalg.slogdet(known)[1]
        learned = len(scale) - np.trace(cho_solve((factor, True), known))
        return cls(rival, scale, np.tril(factor), float(log_det), float(learned))

    def solve(self, right: Array) -> Array:
        """(precision + G)^-1 times some columns. Shape (k, ...) as given."""
        scale = self.scale if right.ndim == 1 else self.scale[:, None]
        return scale * cho_solve((self.factor, True), scale * right)


def expected_log_bayes_factor(gram: Array, a: RivalUpdate, b: RivalUpdate) -> float:
    """Expected log Bayes factor of A against B, A at its found size being true [nats].

    0.5 (d' S_B^-1 d + tr S_B^-1 - tr S_A^-1 + ln det S_B - ln det S_A); below 0 if B
    predicts the same as A with more certainty. The first term is the part of the
    difference d of the two means that a refit of B leaves. The Gram is whitened, (m, m).
    """
    apart = np.zeros(len(gram))
    apart[a.rival.columns] += a.rival.mean
    apart[b.rival.columns] -= b.rival.mean
    seen = gram @ apart
    pull = seen[b.rival.columns]
    gap = max(float(apart @ seen - pull @ b.solve(pull)), 0.0)
    certainty = a.learned - b.learned + b.log_det - a.log_det
    return 0.5 * (gap + certainty)


def rival_log_evidence(products: Array, gram: Array, b: RivalUpdate) -> Array:
    """Log evidence of new rows for a rival, up to what all rivals share [nats].

    From whitened X' y of the shared columns, one column per draw of y, (m, draws), and
    X' X, (m, m). Shape (draws,).
    """
    at, mean = b.rival.columns, b.rival.mean
    own = gram[np.ix_(at, at)]
    left = products[at] - (own @ mean)[:, None]
    fit = 2 * mean @ products[at] - mean @ own @ mean
    return 0.5 * (fit + np.einsum("kd,kd->d", left, b.solve(left)) - b.log_det)


def draw_log_products(gram: Array, a: RivalUpdate, rng: np.random.Generator, draws: int) -> Array:
    """Draw X' y of logs with A true on a motion. Shape (m, draws)."""
    rival = a.rival
    scaled = rival.precision * np.outer(a.scale, a.scale)
    lower = np.linalg.cholesky(scaled)
    free = rng.normal(size=(len(rival.mean), draws))
    theta = a.scale[:, None] * solve_triangular(lower.T, free)
    theta += rival.mean[:, None]
    # R with R R' = G, for a G that may be singular.
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    noise = rng.normal(size=(len(gram), draws))
    return gram[:, rival.columns] @ theta + root @ noise


@dataclass(frozen=True, eq=False, slots=True)
class ExpectedSeparation:
    """Expected separation by a motion, at the identified sizes."""

    # Expected evidence of each separable pair [nats].
    nats: Mapping[Pair, float]
    # Share of the needed evidence that the worst pair gets: at 1 all are expected to be
    # separated.
    share: float

    @property
    def separates_nothing(self) -> bool:
        """Whether it decides nothing."""
        return self.share < HOPELESS


def expect_separation(
    question: OpenQuestion, gram: Array, twins: frozenset[Pair] = frozenset()
) -> ExpectedSeparation:
    """Rate a motion by its Gram matrix, (m, m), without inseparable pairs."""
    nats, shares = {}, []
    for c, contest in enumerate(question.contests):
        after = [RivalUpdate.of(rival, gram) for rival in contest.rivals]
        for a, b in contest.pairs:
            if (c, a, b) in twins:
                continue
            value = max(expected_log_bayes_factor(gram, after[a], after[b]), 0.0)
            nats[c, a, b] = value
            need = contest.enough - contest.lead(a, b)
            shares.append(value / need if need > 0 else np.inf)
    return ExpectedSeparation(nats, float(min(shares, default=0.0)))


class SimulatedDecision(NamedTuple):
    """Simulated decision: outcomes of logs of a motion drawn from the rivals.

    The chance that the true rival leads every separable one by enough, old logs
    included; and its median lead over the nearest [nats].
    """

    chance: float
    nats: float


def simulate_decision(
    question: OpenQuestion, gram: Array, twins: frozenset[Pair], rng: np.random.Generator
) -> SimulatedDecision:
    """Draw logs of every rival, by its probability after the logs so far.

    A rival that no motion separates from any other is left out. The Gram is whitened,
    (m, m).
    """
    chances, nats = [], []
    for c, contest in enumerate(question.contests):
        after = [RivalUpdate.of(rival, gram) for rival in contest.rivals]
        before = np.array([rival.nats for rival in contest.rivals])
        leads, odds = [], []  # of the true rival over the nearest [nats]
        for a, share in enumerate(np.exp(before - before.max())):
            pairs = (b for x, b in contest.pairs if x == a)
            others = [b for b in pairs if (c, a, b) not in twins]
            if not others:
                continue
            products = draw_log_products(gram, after[a], rng, DRAWS)
            own = before[a] + rival_log_evidence(products, gram, after[a])
            best = [before[b] + rival_log_evidence(products, gram, after[b]) for b in others]
            leads.append(own - np.max(best, axis=0))
            odds.append(np.full(DRAWS, share))
        if leads:
            lead, weight = np.concatenate(leads), np.concatenate(odds)
            weight = weight / max(weight.sum(), 1e-300)
            chances.append(float(weight @ (lead >= contest.enough)))
            order = np.argsort(lead)
            half = np.searchsorted(np.cumsum(weight[order]), 0.5)
            nats.append(float(lead[order][min(half, len(lead) - 1)]))
    if not chances:
        return SimulatedDecision(0.0, 0.0)
    return SimulatedDecision(min(float(np.prod(chances)), 1.0), min(nats))


SECONDS = 20.0  # default length of a motion [s]
PERIODS = 2  # of it
TRAVEL = 60.0  # s through the full range: pairs inseparable there are inseparable anywhere
MOTIONS, HARMONICS = 6, 5
TURN = np.pi  # rad to either side: largest part of a range used
UNKNOWN_SPEED = 2.0  # rad/s, where the robot states no limit
RISE = 0.15  # s in which a joint reaches its speed, without an acceleration limit


@dataclass(frozen=True, eq=False, slots=True)
class MotionInformation:
    """The whitened shared columns along a motion, on the rows that count.

    A planned motion exceeds the identification filter only at reversals, where rows do
    not count, so nothing is filtered.
    """

    # Columns at the samples of the motion, or of its start and first period, scaled to
    # the rows of a log. Shape (n, dof, m).
    rows: Array
    rate: float  # samples per second [Hz]
    opening: float  # time from the start after which periods repeat [s]
    edge: float  # time at both ends of a log that does not count [s]

    @classmethod
    def of(
        cls, question: OpenQuestion, motion: Sequence[Array], rate: float, opening: float = 0.0
    ) -> "MotionInformation":
        """Evaluate q, qd and qdd of a motion's start and first period. (n, dof) each.

        More samples improve effects with memory.
        """
        signals, qd = question.signals, motion[1]
        t = signals.start + np.arange(len(motion[0])) / rate
        columns = all_torque_columns(question, question.seen_with.state(rate, t, motion))
        # Rows at and near standstill or reversal do not count.
        still = np.abs(qd) < signals.speed_floor
        still |= np.diff(np.sign(qd), axis=0, prepend=np.sign(qd[:1])) != 0
        still = dilate_mask(still, int(np.ceil(signals.margin * rate)))
        weight = np.sqrt(signals.information * ~still)
        rows = np.sqrt(signals.rate / rate) * (weight[:, :, None] * columns)
        return cls(rows, rate, opening, signals.edge)

    def gram(self, seconds: float) -> Array:
        """Whitened X' X of a log of a length [s], without its ends. (m, m)."""
        first, last = (round(x * self.rate) for x in (self.edge, seconds - self.edge))
        count, start = len(self.rows), round(self.opening * self.rate)
        if last <= count:
            return self._part(first, last)
        times, more = divmod(last - count, count - start)
        total = self._part(first, count) + self._part(start, start + more)
        return total + times * self._part(start, count) if times else total

    def _part(self, first: int, last: int) -> Array:
        flat = self.rows[first : max(last, first)].reshape(-1, self.rows.shape[2])
        return flat.T @ flat


def all_torque_columns(question: OpenQuestion, state: State) -> Array:
    """Return the inertial columns and those of all effects. Shape (n, dof, m)."""
    effects = (placed.regressor(state) for placed in question.effects)
    return np.concatenate([np.asarray(state.regressor), *effects], axis=2)


def describe_plan(
    question: OpenQuestion,
    expected: ExpectedSeparation,
    decision: SimulatedDecision,
    seconds: float,
    after: float | None = None,
) -> dict:
    """Return the expected result of a motion of a length [s], as `next_experiment`.

    The time after which it settles the question [s] is None for never, or if not
    computed.
    """
    rivals = list_separable_rivals(question, expected)
    return {
        "rivals": [{"name": p.name, "joints": list(p.joints)} for p in rivals],
        "family": None,
        "parameters": None,
        "seconds": seconds,
        "sure_after": after,
        "expected_nats": round(decision.nats, 3),
        "chance": round(decision.chance, 3),
        "program": None,
    }


def predict_best_motion(question: OpenQuestion) -> dict | None:
    """Return the expected result of the best of some free motions, as `describe_plan`.

    None if none of them would decide. The settling time is computed only for motions
    that an arm can make.
    """
    if not question.contests:
        return None
    courses = draw_free_motions(question)
    twins = find_inseparable_pairs(question, courses)
    grams = [course.gram(SECONDS) for course in courses]
    expected = [expect_separation(question, gram, twins) for gram in grams]
    best = int(np.argmax([one.share for one in expected]))
    if expected[best].separates_nothing:
        return None
    sure = simulate_decision(question, grams[best], twins, np.random.default_rng(0))
    return describe_plan(question, expected[best], sure, SECONDS)


def find_settling_time(
    question: OpenQuestion, motion: MotionInformation, seconds: float, twins: frozenset[Pair]
) -> tuple[SimulatedDecision, float | None]:
    """Return the outcome of a motion, and the time after which it settles the question.

    The length from its start at which the chance is `SURE` [s], in tenths rounded up;
    None if all of it is not enough.
    """

    def at(length: float) -> SimulatedDecision:
        # The same draws at every length, for comparable results.
        return simulate_decision(question, motion.gram(length), twins, np.random.default_rng(0))

    whole = at(seconds)
    if whole.chance < SURE:
        return whole, None
    low, high = 2 * motion.edge, seconds
    while high - low > max(high / 50, 1 / motion.rate):
        middle = (low + high) / 2
        low, high = (low, middle) if at(middle).chance >= SURE else (middle, high)
    return whole, min(float(np.ceil(10 * high) / 10), seconds)


def find_inseparable_pairs(
    question: OpenQuestion, motions: Sequence[MotionInformation] | None = None
) -> frozenset[Pair]:
    """Return pairs of which the second can imitate the first on any motion.

    The measure is the evidence of the first, at its identified size, beyond the columns
    of the second, on `TRAVEL` seconds through the full range: below the needed lead no
    experiment separates them. In both directions they are twins; in one direction the
    first is a special case of the second.

    The nominal model is excluded: it may imitate both, which its prior rates
    separately.
    """
    motions = draw_free_motions(question) if motions is None else motions
    gram = np.mean([c.gram(TRAVEL + 2 * c.edge) for c in motions], axis=0)
    found = set()
    for c, contest in enumerate(question.contests):
        for a, b in contest.pairs:
            one, other = contest.rivals[a], contest.rivals[b]
            own = len(one.effect_columns) and len(other.effect_columns)
            if own and evidence_beyond_columns(gram, one, other) < contest.enough:
                found.add((c, a, b))
    return frozenset(found)


def mark_inseparable_alternatives(
    question: OpenQuestion, named: Sequence[Place], sets: Sequence[Alternative]
) -> tuple[Alternative, ...]:
    """Return the equally good sets, with those that no motion separates marked."""
    twins = find_inseparable_pairs(question) if sets and question.contests else frozenset()
    same = {
        tuple(question.contests[c].rivals[i].place for i in (a, b))
        for c, a, b in twins
        if (c, b, a) in twins
    }

    def difference(alternative: Alternative) -> tuple[Place, Place]:
        gone = merge_places([place for place in named if place not in alternative.set])
        return gone, merge_places([place for place in alternative.set if place not in named])

    return tuple(
        replace(alternative, separated_by=UNTOLD)
        if difference(alternative) in same
        else alternative
        for alternative in sets
    )


def evidence_beyond_columns(gram: Array, a: Rival, b: Rival) -> float:
    """Evidence of rival a, at its estimated size, beyond the columns of b [nats]."""
    size = 1 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram * np.outer(size, size)
    found = np.isin(a.columns, a.effect_columns)
    at = a.columns[found]
    value = a.mean[found] / size[at]
    mixed = scaled[np.ix_(b.effect_columns, at)] @ value
    inner = np.linalg.pinv(
        scaled[np.ix_(b.effect_columns, b.effect_columns)], rcond=1e-9, hermitian=True
    )
    return 0.5 * float(value @ scaled[np.ix_(at, at)] @ value - mixed @ inner @ mixed)


def list_separable_rivals(question: OpenQuestion, expected: ExpectedSeparation) -> tuple:
    """Return the rivals that a motion separates, each once."""
    contests = question.contests
    parted = {contests[c].rivals[i].place for c, a, b in expected.nats for i in (a, b)}
    every = (r.place for contest in contests for r in contest.rivals)
    return tuple(place for place in dict.fromkeys(every) if place in parted)


def draw_free_motions(question: OpenQuestion) -> list[MotionInformation]:
    """Draw motions without obstacles; the same for the same question."""
    rng = np.random.default_rng(0)
    count = round(SECONDS / PERIODS * question.signals.rate)
    robot = question.nominal.robot
    motions = [draw_fourier_motion(robot, count, rng) for _ in range(MOTIONS)]
    return [MotionInformation.of(question, m, count * PERIODS / SECONDS) for m in motions]


def draw_fourier_motion(
    robot: Robot, count: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Draw a period of five harmonics, scaled to the limits of the joints. (count, dof)."""
    lower, upper = np.maximum(robot.lower, -TURN), np.minimum(robot.upper, TURN)
    limit = np.asarray(robot.velocity_limit, dtype=float)
    speed = np.where(np.isfinite(limit) & (limit > 0), limit, UNKNOWN_SPEED)
    top = speed / RISE
    if robot.acceleration_limit is not None:
        top = np.minimum(top, robot.acceleration_limit)
    order = 2 * np.pi * PERIODS / SECONDS * np.arange(1, HARMONICS + 1)
    turn = np.outer(np.arange(count) / count * SECONDS / PERIODS, order)
    a, b = rng.normal(size=(2, HARMONICS, robot.dof)) / order[:, None]
    q = np.cos(turn) @ a + np.sin(turn) @ b
    qd = np.cos(turn) * order @ b - np.sin(turn) * order @ a
    qdd = -(np.cos(turn) * order**2 @ a + np.sin(turn) * order**2 @ b)
    half, tops = np.ptp(q, axis=0) / 2, [abs(x).max(axis=0) for x in (qd, qdd)]
    size = np.min([(upper - lower) / 2 / half, speed / tops[0], top / tops[1]], axis=0)
    centre = (upper + lower) / 2 - size * (q.max(axis=0) + q.min(axis=0)) / 2
    return centre + size * q, size * qd, size * qdd


# Logs that separate effects which goals and positions alone cannot, on any motion.
#
# The torque of a drive is gain times position error. So all torques are known up to one
# factor per joint, which only a known mass fixes; at one gain a wrong motor constant and
# friction are alike; and damping by the drive equals friction until the drive is off.


def list_separating_logs(robot: Robot, logs: Sequence[Recording]) -> tuple[str, ...]:
    """Return advice on additional logs, a sentence each; none if torque is measured.

    Args:
        logs: The fit logs.
    """
    driven = [log for log in logs if log.drive is not None]
    if not driven:
        return ()
    out = []
    if not any(log.enabled is not None and not log.enabled.all() for log in driven):
        out.append(
            "No log has the drive off: switch it off once while the arm moves, and log "
            "that, to separate damping by the drive from friction."
        )
    if "payload.mass" not in robot.known_values:
        out.append(
            "No mass is known: log once with a weighed load and give it with --known "
            "payload.mass=..., to fix the factor of all torques."
        )
    out.append(
        "Log the same motion at another gain, with a map of its own, to separate "
        "gain and motor constant from viscous friction."
    )
    return tuple(out)
