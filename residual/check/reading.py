"""Readings of a log: which channel, in which sign and unit, is the signal of a joint.

The torques of a reading of the angles are assigned to the joints by
`scipy.optimize.linear_sum_assignment`. Angles make the columns anew, so they are tried
one change at a time: single flips, single swaps, shifts by one joint, all reversed,
other units.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.check.assignment import Scores, best_order, torque_scores
from residual.check.motion import Motion
from residual.check.rules import CHECK
from residual.recording import Array
from residual.robot.robot import Robot

# N m, N mm, kN m, N cm, and torques of the motors.
TORQUE_UNITS = (1.0, 1e-3, 1e3, 1e-2, CHECK.gear)
ANGLE_UNITS = (np.pi / 180, 180 / np.pi)


@dataclass(frozen=True, slots=True)
class Reading:
    """How the columns of a log are read; the map as given is `as_given`.

    Attributes:
        angle_order: Channel of each joint's angle, from 0.
        angle_sign: Sign of each joint's angle.
        angle_unit: Factor on all angles; 1 / CHECK.gear for each joint's own gear.
        torque_order: Channel of each joint's torque, from 0.
        torque_sign: Sign of each joint's torque.
        torque_unit: Factor on all torques.
    """

    angle_order: tuple[int, ...]
    angle_sign: tuple[int, ...]
    angle_unit: float
    torque_order: tuple[int, ...]
    torque_sign: tuple[int, ...]
    torque_unit: float


@dataclass(frozen=True, eq=False, slots=True)
class Judged:
    """A reading with its evidence.

    Attributes:
        reading: The reading.
        nats: Its log evidence.
        odds: Log odds against what is not as given.
        scores: Of its angles, to judge other torques by.
        gears: Factor of each joint's torque where it is the motor's.
    """

    reading: Reading
    nats: float
    odds: float
    scores: Scores
    gears: Array

    def fit(self, channel: int) -> float:
        """Return how well a torque channel (from 0) is explained [nats]."""
        joint = self.reading.torque_order.index(channel)
        _, factor = _torques(self.reading, self.gears)[joint]
        return self.scores.fit(joint, channel, factor)

    def strains(self) -> Array:
        """Return how far the robot file must bend, joint by joint [nats]."""
        read = enumerate(_torques(self.reading, self.gears))
        return np.array([self.scores.strain(j, i, factor) for j, (i, factor) in read])

    @property
    def value(self) -> float:
        """Evidence, less the odds against it."""
        return self.nats - self.odds


def as_given(dof: int) -> Reading:
    """Return the reading of the column map as it is."""
    same, plus = tuple(range(dof)), (1,) * dof
    return Reading(same, plus, 1.0, same, plus, 1.0)


def best_reading(robot: Robot, motion: Motion) -> Judged:
    """Search the reading with the most evidence, one change of the angles at a time."""
    best = _with_torques(robot, motion, as_given(robot.dof), TORQUE_UNITS)
    for _ in range(CHECK.rounds):
        tried = []
        for other in _changed(best.reading, robot.gear_ratio is not None):
            same_unit = other.angle_unit == best.reading.angle_unit
            units = (other.torque_unit,) if same_unit else TORQUE_UNITS
            tried.append(_with_torques(robot, motion, other, units))
        found = max(tried, key=lambda judged: judged.value)
        if found.value <= best.value:
            break
        best = found
    return best


def judge(robot: Robot, motion: Motion, reading: Reading) -> Judged:
    """Return one reading with its evidence."""
    scores, gears = _scores(robot, motion, reading), _gears(robot)
    nats = sum(
        float(scores.evidence(j, channel, np.array([factor]))[0])
        for j, (channel, factor) in enumerate(_torques(reading, gears))
    )
    return Judged(reading, nats, _odds(reading), scores, gears)


def _gears(robot: Robot) -> Array:
    known = robot.gear_ratio is not None
    return np.abs(robot.gear_ratio) if known else np.full(robot.dof, CHECK.gear)


def _torques(reading: Reading, gears: Array) -> list[tuple[int, float]]:
    unit = reading.torque_unit
    units = gears if unit == CHECK.gear else np.full(len(gears), unit)
    factors = [sign * u for sign, u in zip(reading.torque_sign, units, strict=True)]
    return list(zip(reading.torque_order, factors, strict=True))


def _scores(robot: Robot, motion: Motion, reading: Reading) -> Scores:
    unit = np.full(robot.dof, reading.angle_unit)
    if reading.angle_unit == 1 / CHECK.gear and robot.gear_ratio is not None:
        unit = 1 / _gears(robot)
    factor = np.array(reading.angle_sign) * unit
    return torque_scores(robot, motion.with_angles(reading.angle_order, factor))


def _with_torques(
    robot: Robot, motion: Motion, reading: Reading, units: Sequence[float]
) -> Judged:
    """Give a reading of the angles the torques that suit it best."""
    dof = robot.dof
    scores = _scores(robot, motion, reading)
    gears, factors = _gears(robot), np.array([(u, -u) for u in units])
    motors = np.array(units)[:, None] == CHECK.gear
    table = np.array(
        [
            [scores.evidence(j, i, own.ravel()) for i in range(dof)]
            for j, gear in enumerate(gears)
            for own in [np.where(motors, np.sign(factors) * gear, factors)]
        ]
    ).reshape(dof, dof, len(units), 2)
    judged = []
    for k, unit in enumerate(units):
        for usual in (1, -1):
            turned = np.array([1, -1]) != usual
            against = CHECK.odds * (1 - np.eye(dof))[:, :, None] + CHECK.odds * turned
            value = table[:, :, k] - against
            joints, channels = np.arange(dof), best_order(value.max(-1))
            which = value[joints, channels].argmax(-1)
            changed = replace(
                reading,
                torque_order=tuple(int(i) for i in channels),
                torque_sign=tuple(int(1 - 2 * w) for w in which),
                torque_unit=unit,
            )
            nats = float(table[joints, channels, k, which].sum())
            judged.append(Judged(changed, nats, _odds(changed), scores, gears))
    return max(judged, key=lambda each: each.value)


def _odds(reading: Reading) -> float:
    """Log odds against a reading: so much for each thing that is not as given."""
    counts = [
        sum(s < 0 for s in signs) for signs in (reading.torque_sign, reading.angle_sign)
    ]
    # All of them turned are one mistake.
    turned = sum(min(n, 1 + len(reading.torque_sign) - n) for n in counts)
    # Where an arm is its own mirror image it is the torque that is turned; joints
    # turned in one signal are likelier than in two.
    turned += 0.1 * (counts[1] > 0) + 0.5 * (min(counts) > 0)
    moved = [i != j for i, j in enumerate(reading.torque_order)]
    # Angle and torque of a joint moved together are one mistake, not two.
    moved += [
        i != j and reading.torque_order[i] != j
        for i, j in enumerate(reading.angle_order)
    ]
    units = (reading.angle_unit != 1.0) + (reading.torque_unit != 1.0)
    return CHECK.odds * (turned + sum(moved) + units)


def _changed(reading: Reading, geared: bool) -> Iterator[Reading]:
    """Other angles, one change away."""
    order, dof = reading.angle_order, len(reading.angle_order)
    if reading.angle_unit == 1.0:
        for unit in (*ANGLE_UNITS, *((1 / CHECK.gear,) if geared else ())):
            yield replace(reading, angle_unit=unit)
    both = zip(reading.angle_sign, reading.torque_sign, strict=True)
    # Angles that are turned look like torques that are.
    signs = {tuple(angle * torque for angle, torque in both)} - {reading.angle_sign}
    for j in range(dof):
        one = tuple(-s if k == j else s for k, s in enumerate(reading.angle_sign))
        signs.add(one)
    for sign in sorted(signs):
        yield replace(reading, angle_sign=sign)
    orders = {
        reading.torque_order,
        order[::-1],
        (*order[1:], order[0]),
        (order[-1], *order[:-1]),
    }
    for a in range(dof):
        for b in range(a + 1, dof):
            swapped = list(order)
            swapped[a], swapped[b] = swapped[b], swapped[a]
            orders.add(tuple(swapped))
    for other in sorted(orders - {order}):
        yield replace(reading, angle_order=other)
