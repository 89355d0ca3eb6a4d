"""Slips that come together: a torque of any unit or sign, beside another of the map.

What a robot file explains of a torque, friction apart, does not ask for the torque's
factor. So other orders, directions of gravity, turned angles and clocks are compared
while every torque keeps a factor of its own; the factors of the best say what the unit
is, and which signs are turned. One joint may be odd: it may hide a strong effect.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from residual.check.column_reading import (
    build_given_reading,
    compute_parameter_strain,
    score_reading,
    swap_channels,
)
from residual.check.mounting import (
    REMOVED,
    REMOVED_WORDS,
    compute_body_evidence,
    copy_with_gravity,
)
from residual.check.physics_columns import (
    CheckMotion,
    compute_nominal_torque,
    compute_row_rms,
)
from residual.check.result import MOUNTING, Fault, Repair, list_true_joints
from residual.check.thresholds import CHECK
from residual.check.torque_shares import (
    NominalShares,
    build_torque_unit_fault,
    compute_torque_factors,
    fit_nominal_shares,
    select_loaded_joints,
)
from residual.errors import format_joint_numbers, join_with_commas
from residual.recording import Array
from residual.robot.dynamics import compute_gravity_torque
from residual.robot.robot import Robot

_TIMES = (0.1, 0.5, 2.0, 10.0)  # true time over the one given
_ALONE = {"joint_order", "time_unit"}  # what single readings may not see
_NEAREST = 0.02  # of a torque: no file is nearer


@dataclass(frozen=True, eq=False, slots=True)
class TorqueSlips:
    """Slips of a map, and the arm and its motion with them repaired."""

    faults: tuple[Fault, ...]
    robot: Robot
    motion: CheckMotion
    nats: float  # log evidence of the torques as they are in the log, less the odds
    alone: bool = False  # one slip, of signs and units as given

    @property
    def pair(self) -> bool:
        """Whether two kinds, certainly, make it this arm's log."""
        certain = {fault.kind for fault in self.faults if fault.certain}
        return len(certain) > 1


def find_torque_slips(robot: Robot, motion: CheckMotion) -> TorqueSlips | None:
    """Find torque in another unit or of other signs, alone or with one other slip.

    Returns:
        None where there is none, or where two do not make it this arm's log.
    """
    given = _Candidate((), robot, motion, fit_nominal_shares(robot, motion))
    fine = _is_clean(given.shares)
    candidates = list(_candidates(given, fine))
    if not candidates:  # bodies of such a file make no torque to compare
        return None
    best = max(candidates, key=lambda candidate: candidate.nats)
    start = best if best.nats - given.nats > CHECK.suspect_nats else given
    if fine and start is given:
        return None
    return _pair(start) or _rough(start)


def _pair(best: "_Candidate") -> TorqueSlips | None:
    """One or two slips whose repair makes the log fit this arm, or None."""
    best, factor = _turned_back(best)
    factors = compute_torque_factors(best.shares)
    if factors is not None:
        unit = build_torque_unit_fault(best.robot, factors, best.shares)
        known = np.ones(len(factors)) * np.array(unit.repairs[0].scale)
        factor = factor * known
        motion = replace(best.motion, tau=best.motion.tau * known)
        best = replace(best, faults=(*best.faults, unit), motion=motion)
    elif len(best.faults) == 1 and not _is_clean(best.shares):
        again = max(_candidates(best), key=lambda c: c.nats, default=best)
        more = again.nats - best.nats > CHECK.suspect_nats
        best = again if more else best
    kinds = {fault.kind for fault in best.faults}
    alone = factors is None and len(kinds) < 2 and REMOVED not in kinds
    if alone and not (
        kinds <= _ALONE and len(best.faults) == 1 and _explains_joints(best)
    ):
        return None  # single readings of the columns say it all
    robot, motion = best.robot, best.motion
    # What is left of a weight that was taken out strains a body that has none.
    removed = REMOVED in kinds
    strain = (
        0.0
        if removed
        else compute_parameter_strain(
            score_reading(robot, motion, build_given_reading(robot.dof))
        )
    )
    unit_alone = len(best.faults) == 1 and not alone
    if strain > (CHECK.certain_nats if unit_alone else CHECK.suspect_nats):
        return None
    rows = motion.spread * motion.moving.sum(axis=0)
    nats = compute_body_evidence(robot, motion) + float(rows @ np.log(np.abs(factor)))
    nats -= CHECK.odds_nats * len(best.faults)
    return TorqueSlips(best.faults, robot, motion, nats, alone)


def _rough(start: "_Candidate") -> TorqueSlips | None:
    """Suspect a unit, of an arm as it may be mounted, where the file is too rough."""
    factors = compute_torque_factors(start.shares)
    if factors is None or any(fault.kind != MOUNTING for fault in start.faults):
        return None
    unit = build_torque_unit_fault(start.robot, factors, start.shares)
    if not unit.certain:
        return None
    faults = tuple(replace(fault, certain=False) for fault in (*start.faults, unit))
    return TorqueSlips(
        faults, start.robot, start.motion, np.inf if start.faults else -np.inf
    )


def _turned_back(best: "_Candidate") -> tuple["_Candidate", Array]:
    """Turn torques that are so against the sign of the file."""
    shares = best.shares
    shown = select_loaded_joints(shares, CHECK.weak_joint_share) & (
        shares.explained > CHECK.explained_least
    )
    sign = np.where(shown & (shares.ratio < 0), -1.0, 1.0)
    back = list_true_joints(sign < 0)
    if not back:
        return best, sign
    words = (
        f"The torque of {format_joint_numbers(back)} has the wrong sign; "
        f"turned, it fits."
    )
    fault = Fault(
        "torque_sign", back, True, words, (Repair("tau", back, (-1,) * len(back)),)
    )
    motion = replace(best.motion, tau=best.motion.tau * sign)
    shares = replace(shares, ratio=shares.ratio * sign)
    return _Candidate((*best.faults, fault), best.robot, motion, shares), sign


@dataclass(frozen=True, eq=False, slots=True)
class _Candidate:
    """A log with one slip repaired, its torques of any factor."""

    faults: tuple[Fault, ...]
    robot: Robot
    motion: CheckMotion
    shares: NominalShares

    @property
    def nats(self) -> float:
        """What the file explains of the torques, less the odds of their factors."""
        rows = self.motion.spread * self.motion.moving.sum(axis=0)
        left = np.maximum(1 - self.shares.explained, _NEAREST**2)
        # Without weight only inertia is left to say that nothing else is wrong.
        removed = any(fault.kind == REMOVED for fault in self.faults)
        most = CHECK.inertia_ratio if removed else CHECK.unit_ratio
        odds = 0.0 if _near(self.shares, most) else CHECK.odds_nats * len(left)
        return float(-0.5 * np.sum(rows * np.log(left))) - odds


def _near(shares: NominalShares, most: float) -> bool:
    """Whether the torques that carry the arm are in the unit and sign of the file."""
    ratio = shares.ratio[select_loaded_joints(shares)]
    return bool(((ratio > 1 / most) & (ratio < most)).all())


def _is_clean(shares: NominalShares) -> bool:
    """Whether the joints that carry the arm have the torque of the file as it is."""
    return _near(shares, CHECK.unit_ratio) and bool(
        (shares.explained[select_loaded_joints(shares)] > CHECK.explained_well).all()
    )


def _explains_joints(candidate: _Candidate) -> bool:
    """Whether the joints of its slip, or all, have the torque of the file by it."""
    (fault,) = candidate.faults
    if not fault.joints:
        return _is_clean(candidate.shares)
    at = [j - 1 for j in fault.joints]
    ratio, explained = candidate.shares.ratio[at], candidate.shares.explained[at]
    near = (ratio > 1 / CHECK.joint_ratio) & (ratio < CHECK.joint_ratio)
    shows = select_loaded_joints(candidate.shares)[at].any()
    return bool(near.all() and (explained > CHECK.explained_well).all() and shows)


def _candidates(start: _Candidate, only_time: bool = False) -> Iterator[_Candidate]:
    """Other worlds and other columns, one change away."""
    robot, motion = start.robot, start.motion
    changes = _clocks(robot, motion) if only_time else _changed(robot, motion)
    for kind, words, repairs, robot, motion in changes:
        removed = kind == REMOVED
        shares = fit_nominal_shares(start.robot if removed else robot, motion, removed)
        joints = tuple(sorted({j for r in repairs for j in r.joints}))
        repairs = tuple(replace(r, joints=()) if r.order else r for r in repairs)
        fault = Fault(kind, joints, True, f"{words}.", repairs)
        candidate = _Candidate((*start.faults, fault), robot, motion, shares)
        certain = candidate.nats - start.nats > CHECK.certain_nats
        fault = replace(fault, certain=bool(certain))
        yield replace(candidate, faults=(*start.faults, fault))


_Change = tuple[str, str, Sequence[Repair], Robot, CheckMotion]


def _changed(robot: Robot, motion: CheckMotion) -> Iterator[_Change]:
    down = robot.model.gravity.linear
    size, ones = float(np.linalg.norm(down)), np.ones(robot.dof)
    for axis in size * np.vstack([np.eye(3), -np.eye(3)]):
        if axis @ down < 0.9 * size**2:
            words = (
                f"Gravity points along {join_with_commas(down + 0.0, '.3g')} in the "
                f"robot file; "
                f"along {join_with_commas(axis + 0.0, '.3g')} m/s^2 the torques are "
                f"this arm's"
            )
            repair = Repair("robot", gravity=tuple(axis.tolist()))
            yield MOUNTING, words, [repair], copy_with_gravity(robot, axis), motion
    yield REMOVED, REMOVED_WORDS, [], copy_with_gravity(robot, np.zeros(3)), motion
    for order in _orders(robot):
        moved = tuple(j + 1 for j in range(robot.dof) if order[j] != j)
        by_name = tuple(i + 1 for i in order)
        both = motion.reorder_angles(order, ones)
        for signals in (("q", "tau"), ("tau",)):
            rows = both if "q" in signals else motion
            words = (
                f"{' and '.join(signals)} of {format_joint_numbers(moved)} are "
                f"those of other "
                f"joints; in the order {join_with_commas(by_name)} they fit"
            )
            repairs = [Repair(s, moved, order=by_name) for s in signals]
            rows = replace(rows, tau=motion.tau[:, list(order)])
            yield "joint_order", words, repairs, robot, rows
    for j in range(robot.dof):
        sign: Array = np.where(np.arange(robot.dof) == j, -1.0, 1.0)
        words = f"The angle of joint {j + 1} counts backwards; turned, it fits"
        repair = Repair("q", (j + 1,), sign=(-1,))
        rows = motion.reorder_angles(range(robot.dof), sign)
        yield "angle_sign", words, [repair], robot, rows
    yield from _clocks(robot, motion)


def _clocks(robot: Robot, motion: CheckMotion) -> Iterator[_Change]:
    for factor in _TIMES:
        words = f"With time times {factor:g} weight and inertia go together"
        rows = replace(motion, qd=motion.qd / factor, qdd=motion.qdd / factor**2)
        if _light(robot, rows):
            continue  # that is an arm without its weight
        yield "time_unit", words, [Repair("t", scale=factor)], robot, rows


def _light(robot: Robot, motion: CheckMotion) -> bool:
    """Whether inertia is more than weight on the joint with the most weight."""
    nominal = compute_nominal_torque(robot, motion)
    weight = compute_gravity_torque(robot.model, motion.q, robot.model.gravity.linear)
    most = np.argmax(compute_row_rms(weight))
    return bool(
        compute_row_rms(nominal - weight)[most] > compute_row_rms(weight)[most] > 0
    )


def _orders(robot: Robot) -> set[tuple[int, ...]]:
    """Channel of each joint, from 0: two exchanged, reversed, or named by alphabet."""
    names, same = list(robot.model.names)[1:], tuple(range(robot.dof))
    places = sorted(names)
    by_alphabet = tuple(places.index(name) for name in names)
    pairs = {swap_channels(same, *pair) for pair in combinations(same, 2)}
    return (pairs | {by_alphabet, same[::-1]}) - {same}
