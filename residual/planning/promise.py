"""Would another experiment decide what is open? A bound, without designing one.

Motions that know no obstacle, each joint through all of its range as fast as its limits
let it, show how far apart the rivals can come at all. What an arm in its cell can do is
less, and a designed motion aims better than a random one: `modelgap next` looks.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.effects.base import State
from residual.planning.outlook import (
    HOPELESS,
    Outlook,
    chance,
    outlook,
    structural_twins,
)
from residual.planning.question import Question
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.track import prepare, widened

SECONDS = 20.0  # length of a motion where nobody says another [s]
PERIODS = 2  # of it
MOTIONS, HARMONICS = 6, 5
TURN = np.pi  # rad to either side: what of a range is used at most
UNKNOWN_SPEED = 2.0  # rad/s, where the robot states no limit
RISE = 0.15  # s in which a joint reaches its speed, where it states no acceleration


def planned_gram(
    question: Question, motion: Sequence[Array], rate: float, seconds: float
) -> Array:
    """Return X' X of the shared columns on a planned motion, whitened. Shape (m, m).

    A planned motion has nothing above the identification filter but where a joint turns
    round, and there rows do not count: so nothing is filtered.

    Args:
        motion: q, qd and qdd of the whole motion, or of one of its periods. The more
            samples, the better effects with a memory are seen. Shapes (n, dof).
        rate: Samples per second [Hz].
        seconds: Length of the log that it, or its repetition, will fill [s].
    """
    signals = question.signals
    rows = signals.rate * max(seconds - 2 * signals.edge, 0.0)
    x = _whitened(question, motion, rate)
    flat = x.reshape(-1, x.shape[2])
    return rows / len(motion[0]) * flat.T @ flat


def growing_grams(
    question: Question, motion: Sequence[Array], rate: float, until: Sequence[float]
) -> list[Array]:
    """Return X' X of the shared columns on the first seconds of a motion, whitened.

    Args:
        motion: q, qd and qdd of all of it. Shapes (n, dof).
        rate: Samples per second [Hz].
        until: How many seconds, each more than the one before [s].
    """
    signals = question.signals
    x = np.sqrt(signals.rate / rate) * _whitened(question, motion, rate)
    first, total, out = signals.edge, 0.0, []
    for end in until:
        rows = slice(*(round(t * rate) for t in (first, max(end, first))))
        flat = x[rows].reshape(-1, x.shape[2])
        total = total + flat.T @ flat
        out.append(total)
        first = max(end, first)
    return out


def _whitened(question: Question, motion: Sequence[Array], rate: float) -> Array:
    """The shared columns in units of the noise, 0 where a joint stands. (n, dof, m)."""
    signals = question.signals
    t = signals.start + np.arange(len(motion[0])) / rate
    columns = every_column(question, question.seen_with.state(rate, t, motion))
    weight = signals.information * ~standing(question, motion[1], rate)
    return np.sqrt(weight)[:, :, None] * columns


def logged_products(
    question: Question, recording: Recording, until: Sequence[float]
) -> list[tuple[Array, Array]]:
    """Return X' X and X' y of a log up to some times from its first sample, whitened.

    Rows are filtered and left out as in a diagnosis.

    Args:
        until: Times [s].
    """
    floor, model = question.signals.speed_floor, question.nominal
    (track,), _ = prepare([recording], model.filters, floor)
    state = question.seen_with.observe(track)
    columns = track.filter(every_column(question, state))
    y = track.tau - track.filter(model.torque_on(track))
    root = np.sqrt(question.signals.information * track.moving)
    t = track.t[:: track.step] - track.t[0]
    out = []
    for end in until:
        rows = t < end
        x = (root[rows, :, None] * columns[rows]).reshape(-1, columns.shape[2])
        out.append((x.T @ x, x.T @ (root[rows] * y[rows]).ravel()))
    return out


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
    """Return where a joint stands or turns round, and shortly before and after.

    Args:
        qd: Speeds [rad/s]. Shape (n, dof).
        rate: Samples per second [Hz].

    Returns:
        Shape (n, dof), bool.
    """
    still = np.abs(qd) < question.signals.speed_floor
    still |= np.diff(np.sign(qd), axis=0, prepend=np.sign(qd[:1])) != 0
    return widened(still, int(np.ceil(question.signals.margin * rate)))


@dataclass(frozen=True, eq=False, slots=True)
class Promise:
    """What a free motion would do for a question.

    Attributes:
        seen: Of the best of some motions.
        chance: Chance that it settles the question.
        rivals: What it tells apart, each once.
    """

    seen: Outlook
    chance: float
    rivals: tuple

    def document(self) -> dict:
        """Return it as `next_experiment` of a verdict has it: no motion is designed."""
        return {
            "rivals": [{"name": p.name, "joints": list(p.joints)} for p in self.rivals],
            "family": None,
            "parameters": None,
            "seconds": SECONDS,
            "expected_nats": round(self.seen.least, 3),
            "chance": round(self.chance, 3),
            "program": None,
        }


def promised(question: Question) -> Promise | None:
    """Return what free motions promise; None where none of them would decide."""
    if not question.contests:
        return None
    rng = np.random.default_rng(0)
    count = round(SECONDS / PERIODS * question.signals.rate)
    rate = count * PERIODS / SECONDS
    motions = [free_motion(question.nominal.robot, count, rng) for _ in range(MOTIONS)]
    grams = [planned_gram(question, motion, rate, SECONDS) for motion in motions]
    twins = structural_twins(question, grams)
    seen = [outlook(question, gram, twins) for gram in grams]
    best = int(np.argmax([one.worth for one in seen]))
    if seen[best].worth < HOPELESS:
        return None
    sure = chance(question, grams[best], twins, rng)
    return Promise(seen[best], sure, told_apart(question, seen[best]))


def told_apart(question: Question, seen: Outlook) -> tuple:
    """Return the rivals that a motion tells apart, each once."""
    contests = question.contests
    parted = {contests[c].rivals[i].place for c, a, b in seen.nats for i in (a, b)}
    every = (r.place for contest in contests for r in contest.rivals)
    return tuple(place for place in dict.fromkeys(every) if place in parted)


def free_motion(
    robot: Robot, count: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Draw one period of a motion of five harmonics, as large as its joints let it.

    Returns:
        q, qd and qdd [rad, rad/s, rad/s^2]. Shapes (count, dof).
    """
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
