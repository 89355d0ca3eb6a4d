"""Faults of the column map that contradict the physics of the motion."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from residual.check.motion import OUTER, Columns, Motion
from residual.check.reading import (
    GEAR,
    ROUNDS,
    Reading,
    ScoredReading,
    as_given,
    best_reading,
    score_reading,
)
from residual.check.result import Fault, Repair, joints_of
from residual.check.thresholds import CHECK
from residual.errors import joints_listed, listed
from residual.recording import Array
from residual.robot.dynamics import PER_LINK
from residual.robot.robot import Robot

Joints = tuple[int, ...]


def misread(robot: Robot, motion: Motion) -> tuple[list[Fault], Reading]:
    """Find signs, orders and units that another reading of columns explains better."""
    best, given = best_reading(robot, motion), as_given(robot.dof)
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
    fits = bent(was) < CHECK.suspect_nats
    wrong = [] if unknown or fits else _wrong_robot(best, faults)
    return wrong or faults, best.reading


def wrong_robot(robot: Robot, motion: Motion) -> list[Fault]:
    """Find columns that are read rightly, but are not of this arm."""
    return _wrong_robot(score_reading(robot, motion, as_given(robot.dof)), [])


def _wrong_robot(best: ScoredReading, faults: list[Fault]) -> list[Fault]:
    """Another arm, where even the best reading bends the file beyond a rough one.

    Two joints may be odd, or hide an effect; more are another arm.
    """
    nats = bent(best)
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


def bent(scored: ScoredReading) -> float:
    """By how much a robot file must bend, its worst joint left out [nats]."""
    strains = np.minimum(scored.strains(), CHECK.one_joint_nats)
    return float(strains.sum() - strains.max())


def _fault_of(
    robot: Robot, motion: Motion, best: ScoredReading, mistake: "_Mistake"
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


def _units(reading: Reading, gears: Array | None) -> Iterator[_Mistake]:
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


def _places(reading: Reading, default: Reading) -> Iterator[_Mistake]:
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
            f"{' and '.join(r.signal for r in repairs)} of {joints_listed(joints)} are "
            f"those of other joints; in the order {listed(repairs[-1].order)} they fit"
        )
        undone = {"angle_order": given, "torque_order": given}
        yield _Mistake("joint_order", joints, words, repairs, undone)
    angle, torque = (np.array(s) for s in (reading.angle_sign, reading.torque_sign))
    angles, both = joints_of(angle < 0), joints_of((angle < 0) & (torque < 0))
    alone = joints_of((angle > 0) & (torque < 0))
    if angles:
        words = (
            f"The angle of {joints_listed(angles)} counts backwards; turned, it fits"
        )
        repairs = [_turn("q", angles)] + ([_turn("tau", both)] if both else [])
        kept = tuple(np.where(angle < 0, 1, torque).tolist())
        undone = {"angle_sign": default.angle_sign, "torque_sign": kept}
        yield _Mistake("angle_sign", angles, words, repairs, undone)
    if alone:
        words = (
            f"The torque of {joints_listed(alone)} has the wrong sign (friction would "
            "give power, or weight pull upwards); turned, it fits"
        )
        kept = tuple(np.where(angle > 0, 1, torque).tolist())
        repairs = [_turn("tau", alone)]
        yield _Mistake("torque_sign", alone, words, repairs, {"torque_sign": kept})


def _turn(signal: str, joints: Joints) -> Repair:
    return Repair(signal, joints, sign=(-1,) * len(joints))


@dataclass(frozen=True, eq=False, slots=True)
class Part:
    """Sums of one joint's rows over the coefficients of all joints."""

    gram: Array
    model: Array
    torque: Array
    squares: tuple[float, float, float]  # torque^2, torque * model, model^2
    rows: float
    floor: float


def parts_of(motion: Motion, joints: list[Columns]) -> list[Part]:
    """Own columns of each joint side by side, those of the body and outside common."""
    dof, out = len(joints), []
    common = OUTER + PER_LINK * dof
    own = [joint.values.shape[1] - common for joint in joints]
    starts = np.concatenate([[0], np.cumsum(own)])
    strongest = np.sqrt(np.mean(motion.tau**2, axis=0).max())
    for j, joint in enumerate(joints):
        values = np.zeros((len(joint.nominal), starts[-1] + common))
        values[:, starts[j] : starts[j + 1]] = joint.values[:, : own[j]]
        values[:, starts[-1] :] = joint.values[:, own[j] :]
        tau, model = motion.tau[joint.rows, j], joint.nominal
        pairs = ((tau, tau), (tau, model), (model, model))
        weight, rows = motion.spread, motion.spread * len(tau)
        squares = tuple(weight * float(a @ b) for a, b in pairs)
        size = np.sqrt(squares[0] / max(rows, 1e-9))
        floor = max(0.01 * size, 0.001 * strongest, 1e-12)
        sums = (weight * values.T @ x for x in (values, model, tau))
        out.append(Part(*sums, squares, rows, floor))
    return out


def fit_body(parts: list[Part], prior: Array) -> tuple[Array, Array, float]:
    """Fit one body to all torques, by turns with what it leaves of each.

    Args:
        prior: Precision of each coefficient about none.

    Returns:
        What is left of each torque [N m], (dof,); the coefficients; log evidence.
    """
    sigma = np.array([part.floor for part in parts])
    for _ in range(ROUNDS):
        _, at, _ = _fit(parts, sigma, prior)
        for j, part in enumerate(parts):
            power, cross, model = part.squares
            left = power - 2 * cross + model - 2 * at @ (part.torque - part.model)
            left = max(float(left + at @ part.gram @ at), 0.0)
            sigma[j] = max(np.sqrt(left / max(part.rows, 1e-9)), part.floor)
    square, at, size = _fit(parts, sigma, prior)
    noise = sum(part.rows * np.log(sd) for part, sd in zip(parts, sigma, strict=True))
    return sigma, at, float(-0.5 * (square + size) - noise)


def _fit(parts: list[Part], sigma: Array, prior: Array) -> tuple[float, Array, float]:
    """Quadratic form of the rest, coefficients, and log determinant."""
    sums, square = 0.0, 0.0
    gram = np.diag(prior)
    for part, sd in zip(parts, sigma, strict=True):
        power, cross, model = part.squares
        gram += part.gram / sd**2
        sums = sums + (part.torque - part.model) / sd**2
        square += (power - 2 * cross + model) / sd**2
    factor = cho_factor(gram)
    at = cho_solve(factor, sums)
    size = 2 * float(np.log(np.diag(factor[0])).sum()) - float(np.log(prior).sum())
    return square - float(sums @ at), at, size
