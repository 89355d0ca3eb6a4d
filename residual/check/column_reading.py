"""Readings of a log: which channel, in which sign and unit, is the signal of a joint.

The torques of a reading of the angles are assigned to the joints by
`scipy.optimize.linear_sum_assignment`. Angles make the columns anew, so they are tried
one change at a time: single flips, single swaps, shifts by one joint, all reversed,
other units. Where another reading explains a log better than the map, the differences
are the faults of the map.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.linalg import eigh
from scipy.special import log_ndtr

from residual.check.physics_columns import CheckMotion, build_prior_columns
from residual.check.result import Fault, Repair, list_true_joints
from residual.check.thresholds import CHECK
from residual.errors import format_joint_numbers, join_with_commas
from residual.recording import Array
from residual.robot.robot import Robot

GEAR = 100.0  # a usual ratio: motors' torques are so much smaller
ROUNDS = 3
_ROUGH = 0.08  # what a rough model may leave of a torque
_COUPLED = 0.01  # of the strongest channel's rms: what wrists feel of other joints
_EXACT = 1e-6  # of the nominal torque's mean square: no model is nearer
# Noise and all that the model lacks, as a share of the channel's rms.
# A rough model is not said to be nearer than 5 %: what is left is no witness.
_SIGMAS = np.geomspace(0.05, 1.3, 8)


@dataclass(frozen=True, eq=False, slots=True)
class JointScores:
    """Sums from which the evidence of each channel for one joint follows."""

    values: Array  # eigenvalues of the joint's whitened Gram matrix, (p,)
    channel: Array  # channels in its basis, (dof, p)
    model: Array  # the nominal torque in it, (p,)
    brake: Array  # power that friction takes, of coefficients of one, in it, (p,)
    power: Array  # squares of the channels, summed, (dof,)
    channel_variation: Array  # the same about the channel's mean, (dof,)
    cross: Array  # channel times nominal torque, (dof,)
    model_power: float  # squares of the nominal torque, summed
    rows: float  # independent rows
    strongest: float  # largest mean square of a channel

    def fit(self, channel: int, factor: float) -> float:
        """Return that evidence over the one of a constant [nats]."""
        n, power = self.rows, self.channel_variation[channel]
        nothing = -0.5 * n * (np.log(power / max(n, 1) + 1e-300) + 1)
        return self.of(channel, factor) - nothing

    def parameter_strain(self, channel: int, factor: float) -> float:
        """Return how far the robot file must bend to that torque, and still misses it.

        Half the square of its coefficients in deviations of their prior, and what is
        lost by a remainder of more than a rough model leaves of the torque [nats].
        """
        given = np.array([factor])
        best = int(np.argmax(self._table([channel], given)[:, 0, 0]))
        sigma, var = _SIGMAS[best], self._variance([channel], given)[best, 0, 0]
        c = factor * self.channel[channel] - self.model
        bend = 0.5 * float(np.sum((c / (self.values + var)) ** 2))
        missed = self.rows * max(0.0, float(np.log(sigma / _ROUGH)))
        return bend + missed if self.power[channel] else 0.0

    def of(self, channel: int, factor: float) -> float:
        """Return the evidence of one factor."""
        return float(self._table([channel], np.array([factor])).max(axis=0)[0, 0])

    def evidence(self, factor: Array) -> Array:
        """Return log evidence that factor * channel is the torque of the joint.

        Nats, up to a constant of the channel; factors are signs times units, (k,).
        Shape (dof, k).
        """
        return self._table(range(len(self.power)), factor).max(axis=0)

    def _variance(self, channels: Sequence[int], factor: Array) -> Array:
        """Square of noise and of all that the model lacks. (sigmas, channels, k)."""
        n, power = max(self.rows, 1), self.power[list(channels), None]
        var = (_SIGMAS[:, None, None] * factor) ** 2 * power / n
        var += (_COUPLED * factor) ** 2 * self.strongest
        return var + _EXACT * self.model_power / n + 1e-300

    def _table(self, channels: Sequence[int], factor: Array) -> Array:
        """Evidence for each size of what the model lacks. (sigmas, channels, k)."""
        n, d, brake, own = self.rows, self.values, self.brake, list(channels)
        square = factor**2 * self.power[own, None]
        square = square - 2 * factor * self.cross[own, None] + self.model_power
        c = factor[:, None] * self.channel[own, None] - self.model
        var = self._variance(channels, factor)
        wide = d + var[..., None]
        quad = (square - (c**2 / wide).sum(-1)) / var
        size = n * np.log(var) + np.log1p(d / var[..., None]).sum(-1)
        # The odds that friction takes power rather than gives it.
        power, spread = (brake * c / wide).sum(-1), var * (brake**2 / wide).sum(-1)
        brakes = log_ndtr(power / np.sqrt(np.maximum(spread, 1e-300))) + np.log(2)
        return n * np.log(np.abs(factor)) + (brakes - 0.5 * (quad + size))


def compute_joint_scores(robot: Robot, motion: CheckMotion) -> list[JointScores]:
    """Sum up a motion for every joint.

    The torque of joint j is what the columns A of `residual.check.physics_columns` can
    give:

    tau ~ N(Y_j pi_0, sigma^2 1 + A A^T).

    One decomposition of A^T A per joint gives the evidence of every channel, sign and
    unit, for every sigma.
    """
    strongest = float(np.mean(motion.tau**2, axis=0).max())
    out = []
    for own in build_prior_columns(robot, motion):
        weight, a, mean = motion.spread, own.values, own.nominal
        tau = motion.tau[own.rows]
        varying = tau - tau.mean(axis=0) if len(tau) else tau
        values, vectors = eigh(weight * a.T @ a)
        turned = weight * (a @ vectors).T
        out.append(
            JointScores(
                values=np.maximum(values, 0.0),
                channel=np.ascontiguousarray((turned @ tau).T),
                model=turned @ mean,
                brake=vectors.T @ own.brake,
                power=weight * np.sum(tau**2, axis=0),
                channel_variation=weight * np.sum(varying**2, axis=0),
                cross=weight * mean @ tau,
                model_power=weight * float(mean @ mean),
                rows=weight * len(tau),
                strongest=strongest,
            )
        )
    return out


def assign_channels(value: Array) -> Array:
    """Assign a channel to every joint, so that the values are the most in all. (dof,).

    Given what each channel is worth to each joint. Shape (dof, dof).
    """
    if np.all(value.argmax(axis=1) == np.arange(len(value))):
        return np.arange(len(value))
    from scipy.optimize import linear_sum_assignment

    return linear_sum_assignment(value, maximize=True)[1]


# N m, N mm, kN m, N cm, and torques of the motors.
TORQUE_UNITS = (1.0, 1e-3, 1e3, 1e-2, GEAR)
ANGLE_UNITS = (np.pi / 180, 180 / np.pi)


@dataclass(frozen=True, slots=True)
class ColumnReading:
    """How the columns of a log are read; the map as given is one of them."""

    angle_order: tuple[int, ...]  # channel of each joint's angle, from 0
    angle_sign: tuple[int, ...]  # sign of each joint's angle
    angle_unit: float  # factor on all angles; 1 / GEAR for each joint's own gear
    torque_order: tuple[int, ...]  # channel of each joint's torque, from 0
    torque_sign: tuple[int, ...]  # sign of each joint's torque
    torque_unit: float  # factor on all torques


@dataclass(frozen=True, eq=False, slots=True)
class ScoredReading:
    """A reading with its evidence."""

    reading: ColumnReading
    nats: float  # its log evidence
    odds_nats: float  # log odds against what is not as given
    scores: list[JointScores]  # of its angles, to judge other torques by
    # Channel (from 0) and factor of each joint's torque.
    torque_factors: list[tuple[int, float]]

    def fit(self, channel: int) -> float:
        """Return how well a torque channel (from 0) is explained [nats]."""
        joint = self.reading.torque_order.index(channel)
        return self.scores[joint].fit(*self.torque_factors[joint])

    def parameter_strains(self) -> Array:
        """Return how far the robot file must bend, joint by joint [nats]."""
        pairs = zip(self.scores, self.torque_factors, strict=True)
        return np.array([own.parameter_strain(*torque) for own, torque in pairs])

    @property
    def value(self) -> float:
        """Evidence, less the odds against it."""
        return self.nats - self.odds_nats


def build_given_reading(dof: int) -> ColumnReading:
    """Return the reading of the column map as it is."""
    same, plus = tuple(range(dof)), (1,) * dof
    return ColumnReading(same, plus, 1.0, same, plus, 1.0)


def search_best_reading(robot: Robot, motion: CheckMotion) -> ScoredReading:
    """Search the reading with the most evidence, one change of the angles at a time."""
    best = _with_torques(robot, motion, build_given_reading(robot.dof), TORQUE_UNITS)
    for _ in range(ROUNDS):
        tried = []
        for other in _neighbors(best.reading, robot.gear_ratio is not None):
            same_unit = other.angle_unit == best.reading.angle_unit
            units = (other.torque_unit,) if same_unit else TORQUE_UNITS
            tried.append(_with_torques(robot, motion, other, units))
        found = max(tried, key=lambda scored: scored.value)
        if found.value <= best.value:
            break
        best = found
    return best


def score_reading(
    robot: Robot, motion: CheckMotion, reading: ColumnReading
) -> ScoredReading:
    """Return one reading with its evidence."""
    scores, torques = _scores(robot, motion, reading), _torques(reading, _gears(robot))
    nats = sum(own.of(*torque) for own, torque in zip(scores, torques, strict=True))
    return ScoredReading(reading, nats, compute_reading_odds(reading), scores, torques)


def apply_reading(
    robot: Robot, motion: CheckMotion, reading: ColumnReading
) -> CheckMotion:
    """Return a motion as another reading of its columns has it."""
    gears = _gears(robot)
    torques = _torques(reading, gears)
    factor = np.array([f for _, f in torques])
    angles = motion.reorder_angles(reading.angle_order, _angle_factors(robot, reading))
    return replace(angles, tau=motion.tau[:, list(reading.torque_order)] * factor)


def _angle_factors(robot: Robot, reading: ColumnReading) -> Array:
    unit = np.full(robot.dof, reading.angle_unit)
    if reading.angle_unit == 1 / GEAR and robot.gear_ratio is not None:
        unit = 1 / _gears(robot)
    return np.array(reading.angle_sign) * unit


def _gears(robot: Robot) -> Array:
    known = robot.gear_ratio is not None
    return np.abs(robot.gear_ratio) if known else np.full(robot.dof, GEAR)


def _torques(reading: ColumnReading, gears: Array) -> list[tuple[int, float]]:
    unit = reading.torque_unit
    units = gears if unit == GEAR else np.full(len(gears), unit)
    factors = [sign * u for sign, u in zip(reading.torque_sign, units, strict=True)]
    return list(zip(reading.torque_order, factors, strict=True))


def _scores(
    robot: Robot, motion: CheckMotion, reading: ColumnReading
) -> list[JointScores]:
    factor = _angle_factors(robot, reading)
    return compute_joint_scores(
        robot, motion.reorder_angles(reading.angle_order, factor)
    )


def _with_torques(
    robot: Robot, motion: CheckMotion, reading: ColumnReading, units: Sequence[float]
) -> ScoredReading:
    """Give a reading of the angles the torques that suit it best."""
    dof = robot.dof
    scores = _scores(robot, motion, reading)
    gears, factors = _gears(robot), np.array([(u, -u) for u in units])
    motors = np.array(units)[:, None] == GEAR
    rows = []
    for own, gear in zip(scores, gears, strict=True):
        tried = np.where(motors, np.sign(factors) * gear, factors).ravel()
        rows.append(own.evidence(tried))
    table = np.array(rows).reshape(dof, dof, len(units), 2)
    scored = []
    for k, unit in enumerate(units):
        for usual in (1, -1):
            turned = np.array([1, -1]) != usual
            against = (
                CHECK.odds_nats * (1 - np.eye(dof))[:, :, None]
                + CHECK.odds_nats * turned
            )
            value = table[:, :, k] - against
            joints, channels = np.arange(dof), assign_channels(value.max(-1))
            which = value[joints, channels].argmax(-1)
            changed = replace(
                reading,
                torque_order=tuple(int(i) for i in channels),
                torque_sign=tuple(int(1 - 2 * w) for w in which),
                torque_unit=unit,
            )
            nats = float(table[joints, channels, k, which].sum())
            torques = _torques(changed, gears)
            scored.append(
                ScoredReading(
                    changed, nats, compute_reading_odds(changed), scores, torques
                )
            )
    return max(scored, key=lambda each: each.value)


def compute_reading_odds(reading: ColumnReading) -> float:
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
    return CHECK.odds_nats * (turned + sum(moved) + units)


def swap_channels(order: Sequence[int], a: int, b: int) -> tuple[int, ...]:
    """Return an order with two of its joints (from 0) exchanged."""
    out = list(order)
    out[a], out[b] = out[b], out[a]
    return tuple(out)


def _neighbors(reading: ColumnReading, geared: bool) -> Iterator[ColumnReading]:
    """Other angles, one change away."""
    order, dof = reading.angle_order, len(reading.angle_order)
    if reading.angle_unit == 1.0:
        for unit in (*ANGLE_UNITS, *((1 / GEAR,) if geared else ())):
            yield replace(reading, angle_unit=unit)
    both = zip(reading.angle_sign, reading.torque_sign, strict=True)
    # Angles that are turned look like torques that are.
    signs = {tuple(angle * torque for angle, torque in both)} - {reading.angle_sign}
    for j in range(dof):
        signs.add(tuple(-s if k == j else s for k, s in enumerate(reading.angle_sign)))
    for sign in sorted(signs):
        yield replace(reading, angle_sign=sign)
    shifted = (*order[1:], order[0]), (order[-1], *order[:-1])
    orders = {reading.torque_order, order[::-1], *shifted}
    orders |= {swap_channels(order, *pair) for pair in combinations(range(dof), 2)}
    for other in sorted(orders - {order}):
        yield replace(reading, angle_order=other)


Joints = tuple[int, ...]


def find_misread_columns(
    robot: Robot, motion: CheckMotion
) -> tuple[list[Fault], ColumnReading]:
    """Find signs, orders and units that another reading of columns explains better."""
    best, given = search_best_reading(robot, motion), build_given_reading(robot.dof)
    if best.reading == given:
        return [], given
    was = score_reading(robot, motion, given)
    if best.value - was.value < CHECK.suspect_nats - CHECK.odds_nats:
        return [], given
    reading = best.reading
    mistakes = [*_places(reading, given), *_units(reading, robot.gear_ratio)]
    scored = (_fault_of(robot, motion, best, mistake) for mistake in mistakes)
    faults = [fault for fault in scored if fault]
    if best.value - was.value < CHECK.certain_nats:
        faults = [replace(fault, certain=False) for fault in faults]
    if not faults:
        return [], given
    # Motors whose gears are not known are no other arm.
    unknown = robot.gear_ratio is None and {f.kind for f in faults} == {"gear_ratio"}
    fits = compute_parameter_strain(was) < CHECK.suspect_nats
    wrong = [] if unknown or fits else _wrong_robot(best, faults)
    return wrong or faults, best.reading


def find_wrong_robot(robot: Robot, motion: CheckMotion) -> list[Fault]:
    """Find columns that are read rightly, but are not of this arm."""
    return _wrong_robot(
        score_reading(robot, motion, build_given_reading(robot.dof)), []
    )


def _wrong_robot(best: ScoredReading, faults: list[Fault]) -> list[Fault]:
    """Another arm, where even the best reading bends the file beyond a rough one.

    Two joints may be odd, or hide an effect; more are another arm.
    """
    nats = compute_parameter_strain(best)
    kinds = len({fault.kind for fault in faults})
    least = CHECK.suspect_nats if kinds else CHECK.certain_nats
    if nats < least:
        return []
    tried = f" (the best: {', '.join(sorted({f.kind for f in faults}))})"
    words = (
        "No single reordering, sign or unit change makes this log fit the robot"
        f"{tried if kinds else ''}: masses and inertias of several joints would be far "
        f"from the robot file ({nats:.0f} nats without the worst joint)."
    )
    certain = nats > CHECK.broken_nats or any(fault.certain for fault in faults)
    return [Fault("wrong_robot", (), certain, words)]


def compute_parameter_strain(scored: ScoredReading) -> float:
    """By how much a robot file must bend, its worst joint left out [nats]."""
    strains = np.minimum(scored.parameter_strains(), CHECK.one_joint_nats)
    return float(strains.sum() - strains.max())


def _fault_of(
    robot: Robot, motion: CheckMotion, best: ScoredReading, mistake: "_Mistake"
) -> Fault | None:
    """Return the fault if the reading without its repair is worse by enough."""
    kind, joints, words, repairs, undone = mistake
    other = score_reading(robot, motion, replace(best.reading, **undone))
    nats = best.nats - other.nats
    # Undoing a mistake of the map may not make any of its joints worse.
    worse = [j - 1 for j in joints or range(1, robot.dof + 1)]
    suffers = max(other.fit(j) - best.fit(j) for j in worse)
    # What is said of all joints must be true of each.
    most = nats / CHECK.loss_ratio
    most = most if joints else min(most, CHECK.suspect_nats)
    if nats < CHECK.suspect_nats or suffers > most:
        return None
    evidence = f"{words} better by {nats:.0f} nats."
    return Fault(kind, joints, nats > CHECK.certain_nats, evidence, tuple(repairs))


class _Mistake(NamedTuple):
    """A difference of a reading from the map, and the fields that undo it."""

    kind: str
    joints: Joints
    words: str
    repairs: list[Repair]
    undone: dict[str, object]


def _units(reading: ColumnReading, gears: Array | None) -> Iterator[_Mistake]:
    """Other units of torques and angles; known gear ratios fix those of motors."""
    unit, angle = reading.torque_unit, reading.angle_unit
    joints = tuple(range(1, len(reading.angle_order) + 1))
    known = () if gears is None else tuple(float(abs(g)) for g in gears)
    undone, repairs, words = {}, [], []
    if unit == GEAR:
        undone["torque_unit"] = 1.0
        words.append(
            "The torques are tens to hundreds of times smaller than this arm's"
        )
        repairs += [Repair("tau", joints, scale=known)] if known else []
    if angle == 1 / GEAR:
        undone["angle_unit"] = 1.0
        words.append("The angles are tens to hundreds of times larger than this arm's")
        repairs.append(Repair("q", joints, scale=tuple(1 / gear for gear in known)))
    if undone:
        text = (
            f"{'. '.join(words)}: they look like those of the motors; by the gears "
            "they fit"
        )
        yield _Mistake("gear_ratio", (), text, repairs, undone)
    if unit not in (1.0, GEAR):
        text = (
            f"The torques are about {1 / unit:g} times what this arm takes for this "
            f"motion; times {unit:g} they fit"
        )
        repairs = [Repair("tau", scale=unit)]
        yield _Mistake("torque_unit", (), text, repairs, {"torque_unit": 1.0})
    if angle not in (1.0, 1 / GEAR):
        what = "degrees" if angle < 1 else "radians that were taken for degrees"
        text = f"The angles look like {what}; times {angle:.6g} they fit"
        repairs = [Repair("q", scale=angle)]
        yield _Mistake("angle_unit", (), text, repairs, {"angle_unit": 1.0})


def _places(reading: ColumnReading, default: ColumnReading) -> Iterator[_Mistake]:
    """Other orders and signs than those of the map as given."""
    given = default.angle_order
    orders = {"q": reading.angle_order, "tau": reading.torque_order}
    repairs = [
        Repair(signal, order=tuple(i + 1 for i in order))
        for signal, order in orders.items()
        if order != given
    ]
    if repairs:
        joints = tuple(j + 1 for j in given if any(o[j] != j for o in orders.values()))
        words = (
            f"{' and '.join(r.signal for r in repairs)} of "
            f"{format_joint_numbers(joints)} are "
            f"those of other joints; in the order "
            f"{join_with_commas(repairs[-1].order)} they fit"
        )
        undone = {"angle_order": given, "torque_order": given}
        yield _Mistake("joint_order", joints, words, repairs, undone)
    angle, torque = (np.array(s) for s in (reading.angle_sign, reading.torque_sign))
    angles, both = (
        list_true_joints(angle < 0),
        list_true_joints((angle < 0) & (torque < 0)),
    )
    alone = list_true_joints((angle > 0) & (torque < 0))
    if angles:
        words = (
            f"The angle of {format_joint_numbers(angles)} counts backwards; "
            f"turned, it fits"
        )
        repairs = [_turn("q", angles)] + ([_turn("tau", both)] if both else [])
        kept = tuple(np.where(angle < 0, 1, torque).tolist())
        undone = {"angle_sign": default.angle_sign, "torque_sign": kept}
        yield _Mistake("angle_sign", angles, words, repairs, undone)
    if alone:
        words = (
            f"The torque of {format_joint_numbers(alone)} has the wrong sign "
            f"(friction would "
            "give power, or weight pull upwards); turned, it fits"
        )
        kept = tuple(np.where(angle > 0, 1, torque).tolist())
        repairs = [_turn("tau", alone)]
        yield _Mistake("torque_sign", alone, words, repairs, {"torque_sign": kept})


def _turn(signal: str, joints: Joints) -> Repair:
    return Repair(signal, joints, sign=(-1,) * len(joints))
