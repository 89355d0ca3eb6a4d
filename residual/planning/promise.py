"""Would another experiment decide what is open? A bound, without designing one.

Motions that know no obstacle, each joint through all of its range as fast as its limits
let it, show how far apart the rivals can come at all. What an arm in its cell can do is
less, and a designed motion aims better than a random one: `modelgap next` looks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects.base import State
from residual.planning.outlook import Outlook, Pair, Prospect, outlook, prospect
from residual.planning.question import Question, Rival, together
from residual.quantity import number, probability
from residual.recording import Array
from residual.robot.robot import Robot
from residual.signals.track import widened
from residual.verdict.result import UNTOLD, Alternative, Place

SECONDS = 20.0  # length of a motion where nobody says another [s]
PERIODS = 2  # of it
TRAVEL = 60.0  # s through all of the range: what cannot be told there is told nowhere
SURE = 0.8  # chance from which a motion is called enough
MOTIONS, HARMONICS = 6, 5
TURN = np.pi  # rad to either side: what of a range is used at most
UNKNOWN_SPEED = 2.0  # rad/s, where the robot states no limit
RISE = 0.15  # s in which a joint reaches its speed, where it states no acceleration


@dataclass(frozen=True, eq=False, slots=True)
class Course:
    """The shared columns along a motion, whitened: what of it counts, second by second.

    A planned motion has nothing above the identification filter but where a joint turns
    round, and there rows do not count: so nothing is filtered.
    """

    # Columns at the samples of the motion, or of its opening and first period, scaled
    # to the rows that a log has of it. Shape (n, dof, m).
    rows: Array
    rate: float  # samples per second [Hz]
    opening: float  # time from the start that no later period repeats [s]
    edge: float  # time at both ends of a log that does not count [s]

    @classmethod
    def of(
        cls,
        question: Question,
        motion: Sequence[Array],
        rate: float,
        opening: float = 0.0,
    ) -> "Course":
        """Look at q, qd and qdd of a motion's opening and first period. (n, dof) each.

        The more samples, the better effects with a memory are seen.
        """
        signals = question.signals
        t = signals.start + np.arange(len(motion[0])) / rate
        columns = every_column(question, question.seen_with.state(rate, t, motion))
        weight = np.sqrt(signals.information * ~standing(question, motion[1], rate))
        rows = np.sqrt(signals.rate / rate) * (weight[:, :, None] * columns)
        return cls(rows, rate, opening, signals.edge)

    def gram(self, seconds: float) -> Array:
        """X' X of a log of so many seconds, whitened, its ends left out. (m, m)."""
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


def every_column(question: Question, state: State) -> Array:
    """Return the inertial columns and those of all effects. Shape (n, dof, m)."""
    n, dof = state.q.shape
    parts = [np.asarray(state.regressor)]
    for effect, joints, shape in question.effects:
        own = effect.columns(state, joints, shape)
        part = np.zeros((n, dof, own.shape[2]))
        part[:, list(effect.rows(joints, dof))] = own
        parts.append(part)
    return np.concatenate(parts, axis=2)


def standing(question: Question, qd: Array, rate: float) -> Array:
    """Return where a joint stands or turns round, and next to that. (n, dof)."""
    still = np.abs(qd) < question.signals.speed_floor
    still |= np.diff(np.sign(qd), axis=0, prepend=np.sign(qd[:1])) != 0
    return widened(still, int(np.ceil(question.signals.margin * rate)))


def plan_of(
    question: Question,
    expected: Outlook,
    sure: Prospect,
    seconds: float,
    after: float | None = None,
) -> dict:
    """Return what a motion of that length [s] promises, as `next_experiment` has it.

    After how long it settles the question surely [s] is None for never, and where that
    was not computed.
    """
    rivals = separable_rivals(question, expected)
    return {
        "rivals": [{"name": p.name, "joints": list(p.joints)} for p in rivals],
        "family": None,
        "parameters": None,
        "seconds": seconds,
        "sure_after": after,
        "expected_nats": round(sure.nats, 3),
        "chance": round(sure.chance, 3),
        "program": None,
    }


def sure_words(seconds: float, after: float | None, chance: float) -> str:
    """Return how soon and how surely a motion settles its question, in words."""
    whole = f"all {number(seconds)} s of it with a chance of {probability(chance)}"
    if after is None:
        return f"settled by {whole}"
    return (
        f"settled after {after:.1f} s with a chance of {probability(SURE)}, by {whole}"
    )


def promised(question: Question) -> dict | None:
    """Return what the best of some free motions promises, as `plan_of`.

    None where none of them would decide. How much of a motion is enough is asked of one
    that an arm can make.
    """
    if not question.contests:
        return None
    courses = free_courses(question)
    twins = structural_twins(question, courses)
    grams = [course.gram(SECONDS) for course in courses]
    expected = [outlook(question, gram, twins) for gram in grams]
    best = int(np.argmax([one.share for one in expected]))
    if expected[best].hopeless:
        return None
    sure = prospect(question, grams[best], twins, np.random.default_rng(0))
    return plan_of(question, expected[best], sure, SECONDS)


def sure_after(
    question: Question, course: Course, seconds: float, twins: frozenset[Pair]
) -> tuple[Prospect, float | None]:
    """Return what a motion brings, and after how long it settles the question surely.

    The length from its start at which the chance is `SURE` [s], in tenths rounded up;
    None where all of it is not enough.
    """

    def at(length: float) -> Prospect:
        # The same draws at every length, so that more of a motion is no matter of luck.
        return prospect(question, course.gram(length), twins, np.random.default_rng(0))

    whole = at(seconds)
    if whole.chance < SURE:
        return whole, None
    low, high = 2 * course.edge, seconds
    while high - low > max(high / 50, 1 / course.rate):
        middle = (low + high) / 2
        low, high = (low, middle) if at(middle).chance >= SURE else (middle, high)
    return whole, min(float(np.ceil(10 * high) / 10), seconds)


def structural_twins(
    question: Question, courses: Sequence[Course] | None = None
) -> frozenset[Pair]:
    """Return pairs of which the second can be what the first is, on any motion.

    What is weighed is what the first, at the size that was found of it, has beyond the
    columns of the second, on `TRAVEL` seconds through all of the range: below what a
    contest takes, no experiment tells. Both ways round they are twins; one way round
    the first is a case of the second.

    What the nominal model could do in their place is left out: it may be able to
    imitate both, and its values speak for or against that.
    """
    courses = free_courses(question) if courses is None else courses
    gram = np.mean([c.gram(TRAVEL + 2 * c.edge) for c in courses], axis=0)
    found = set()
    for c, contest in enumerate(question.contests):
        for a, b in contest.pairs:
            one, other = contest.rivals[a], contest.rivals[b]
            own = len(one.effect_columns) and len(other.effect_columns)
            if own and nats_beyond(gram, one, other) < contest.enough:
                found.add((c, a, b))
    return frozenset(found)


def settled_by(
    question: Question, named: Sequence[Place], sets: Sequence[Alternative]
) -> tuple[Alternative, ...]:
    """Return the equally good sets; marks those that no motion separates."""
    twins = structural_twins(question) if sets and question.contests else frozenset()
    same = {
        tuple(question.contests[c].rivals[i].place for i in (a, b))
        for c, a, b in twins
        if (c, b, a) in twins
    }

    def difference(alternative: Alternative) -> tuple[Place, Place]:
        gone = together([place for place in named if place not in alternative.set])
        return gone, together(
            [place for place in alternative.set if place not in named]
        )

    return tuple(
        replace(alternative, separated_by=UNTOLD)
        if difference(alternative) in same
        else alternative
        for alternative in sets
    )


def nats_beyond(gram: Array, a: Rival, b: Rival) -> float:
    """Evidence of rival a, at its estimated size, beyond the columns of b [nats]."""
    size = 1 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram * np.outer(size, size)
    found = np.isin(a.columns, a.effect_columns)
    at = a.columns[found]
    value = a.mean[found] / size[at]
    mixed = scaled[np.ix_(b.effect_columns, at)] @ value
    inner = np.linalg.pinv(
        scaled[np.ix_(b.effect_columns, b.effect_columns)],
        rcond=1e-9,
        hermitian=True,
    )
    return 0.5 * float(value @ scaled[np.ix_(at, at)] @ value - mixed @ inner @ mixed)


def separable_rivals(question: Question, expected: Outlook) -> tuple:
    """Return the rivals that a motion tells apart, each once."""
    contests = question.contests
    parted = {contests[c].rivals[i].place for c, a, b in expected.nats for i in (a, b)}
    every = (r.place for contest in contests for r in contest.rivals)
    return tuple(place for place in dict.fromkeys(every) if place in parted)


def free_courses(question: Question) -> list[Course]:
    """Draw motions that know no obstacle; the same for the same question."""
    rng = np.random.default_rng(0)
    count = round(SECONDS / PERIODS * question.signals.rate)
    robot = question.nominal.robot
    motions = [free_motion(robot, count, rng) for _ in range(MOTIONS)]
    return [Course.of(question, m, count * PERIODS / SECONDS) for m in motions]


def free_motion(
    robot: Robot, count: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Draw a period of five harmonics, as large as the joints let it. (count, dof)."""
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
