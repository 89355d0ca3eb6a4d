"""Would another experiment decide what is open? A bound, without designing one.

Motions that know no obstacle, each joint through all of its range as fast as its limits
let it, show how far apart the rivals can come at all. What an arm in its cell can do is
less, and a designed motion aims better than a random one: `modelgap next` looks.
"""

from dataclasses import dataclass

import numpy as np

from residual.planning.columns import planned_gram
from residual.planning.outlook import (
    HOPELESS,
    Outlook,
    chance,
    outlook,
    structural_twins,
)
from residual.planning.question import Question
from residual.recording import Array
from residual.robot.robot import Robot

SECONDS = 20.0  # length of a motion where nobody says another [s]
PERIODS = 2  # of it
MOTIONS, HARMONICS = 6, 5
TURN = np.pi  # rad to either side: what of a range is used at most
UNKNOWN_SPEED = 2.0  # rad/s, where the robot states no limit
RISE = 0.15  # s in which a joint reaches its speed, where it states no acceleration


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
    told = {contests[c].rivals[i].place for c, a, b in seen.nats for i in (a, b)}
    every = (r.place for contest in contests for r in contest.rivals)
    return tuple(place for place in dict.fromkeys(every) if place in told)


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
