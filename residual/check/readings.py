"""The reading of a log: the slips that explain it best, and rival causes.

The log as given is scored first. Readings of the torques alone (signs, units, factors,
exchanged channels) share its Gram matrix. Other arrangements of angles, clock and
gravity are tried only where some joint strains the robot file; slips are added to the
best until none improves it.

A fault is certain only if its reading wins under a rough file and under an almost free
one, over the log as given with every other cause; if friction then dissipates power; and
if the log in that reading does not strain the file. Else it is suspected, with its rivals.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from operator import attrgetter

import numpy as np

from residual.check.evidence import (
    GIVEN,
    LOOSE,
    ROUGH,
    ArmFit,
    ArmSums,
    CheckMotion,
    NominalShares,
    Torques,
    find_tilted_gravity,
    fit_arm,
    fit_nominal_shares,
    is_possible,
    list_other_causes,
    measure_strain,
    sum_arm,
)
from residual.check.result import MOUNTING, REMOVED, Fault, list_true_joints, name_fault
from residual.check.slips import (
    SIGNS,
    Slip,
    build_mounting_slip,
    build_order_slip,
    build_sign_slips,
    build_zero_slip,
    list_arrangement_slips,
    list_factor_slips,
    list_removals,
    list_scale_slips,
    measure_angle,
    merge_slips,
    repair_motion,
    repair_torques,
    split_signs,
    swap_channels,
)
from residual.check.thresholds import CHECK
from residual.recording import Array
from residual.robot.robot import Robot

_DEPTH = 2  # slips of an arrangement at most
_POLISHED = 3  # arrangements with torques read in turn
_BRAKES = 2.0  # deviations: friction that dissipates power
_ALIKE = 3.0  # nats: readings that these logs do not separate
_EQUAL = 0.05  # nats: readings that no log separates, such as an arm and its mirror image
_ZERO_STEPS = (0.2, 0.1, 0.05, 0.025)  # rad, step of a zero
# Kinds that may also be due to a file, a balanced arm or an effect.
_NEVER_CERTAIN = ("time_unit", REMOVED, "torque_scale")
_SCALED = ("torque_unit", "gear_ratio")
_BY_VALUE, _BY_SKETCH = attrgetter("value"), attrgetter("sketched")


@dataclass(frozen=True, eq=False)
class Reading:
    """A log under a set of slips."""

    slips: tuple[Slip, ...]
    sums: ArmSums
    torques: Torques

    def fit(self, scale: float) -> ArmFit:
        """Return the arm fitted to its torques, with a prior on the bodies."""
        return fit_arm(self.sums, self.torques, self.sums.deviations(scale))

    @cached_property
    def nats(self) -> float:
        """Log evidence under the bodies of the file, or under a rough one."""
        return max(self.filed.nats, self.rough.nats) - self.share_odds

    @cached_property
    def filed(self) -> ArmFit:
        """The arm fitted to its torques under the file as given."""
        return self.fit(GIVEN)

    @cached_property
    def rough(self) -> ArmFit:
        """The arm fitted to its torques under a rough file."""
        return self.fit(ROUGH)

    @cached_property
    def shares(self) -> NominalShares:
        """Shares of the file's torque in the channels."""
        return fit_nominal_shares(self.sums, self.torques.order)

    @property
    def explains(self) -> bool:
        """Whether the torques that carry the arm contain that of the file."""
        part = self.shares.explained[self.shares.loaded()]
        return bool(np.median(part) > CHECK.explained_least)

    @cached_property
    def share_odds(self) -> float:
        """Log odds against the shares of the file's torque on the loaded joints.

        A rough file, a load and gear losses also change the shares.
        """
        shares = self.shares
        ratio = shares.ratio * self.torques.factor
        shows = shares.loaded() & (shares.explained > CHECK.explained_least)
        shows &= (ratio > 0) & (shares.ratio_sd < CHECK.ratio_sd * abs(shares.ratio))
        away = np.log(ratio[shows]) / np.log(1 + CHECK.share_sd)
        return float(0.5 * np.sum(np.minimum(away**2, CHECK.certain_nats)))

    @property
    def value(self) -> float:
        """Evidence, less the odds against it."""
        return self.nats - self.odds

    @property
    def odds(self) -> float:
        """Log odds against its slips."""
        return CHECK.odds_nats * sum(slip.odds for slip in self.slips)

    @property
    def sketched(self) -> float:
        """Value under a rough file alone."""
        return self.rough.nats - self.share_odds - self.odds

    @cached_property
    def strain(self) -> Array:
        """Deviation from the file, joint by joint [nats]. Shape (dof,)."""
        return measure_strain(self.sums, self.rough)

    @property
    def bend(self) -> float:
        """Evidence of a rough file over the one given [nats]."""
        return max(self.rough.nats - self.filed.nats, 0.0) + self.share_odds

    @property
    def bends(self) -> bool:
        """Whether the file is far from the log: a rough one is likelier, or also far."""
        far = bool(self.strain.sum() > CHECK.certain_nats)
        return far or self.rough.nats - self.filed.nats > CHECK.suspect_nats

    @property
    def strained(self) -> bool:
        """Whether the log strains the bodies of the file."""
        nats = self.strain.sum() + 0.5 * self.share_odds
        return self.rough.nats > self.filed.nats or bool(nats > CHECK.odds_nats)

    @property
    def arranged(self) -> set[str]:
        """Kinds of its slips that concern more than the torques."""
        return {slip.kind for slip in self.slips if not slip.of_torques}

    @property
    def name(self) -> str:
        """Its slips in words."""
        return " and ".join(name_fault(slip.kind, slip.joints) for slip in self.slips)


@dataclass(frozen=True, eq=False)
class Search:
    """The readings of one motion; `arms` remembers the sums of each arrangement."""

    robot: Robot
    motion: CheckMotion
    speeds_agree: bool
    arms: dict[tuple, ArmSums] = field(default_factory=dict)

    def read(self, slips: Sequence[Slip]) -> Reading:
        """Return the reading of some slips."""
        slips = merge_slips(slips, self.robot.dof)
        repairs = tuple(r for slip in slips for r in slip.repairs)
        weightless = any(slip.kind == REMOVED for slip in slips)
        arranged = tuple(r for r in repairs if r.signal != "tau")
        key = (arranged, weightless)
        if key not in self.arms:
            parts = repair_motion(self.robot, self.motion, arranged)
            self.arms[key] = sum_arm(*parts, weightless)
        torques = repair_torques(repairs, self.robot.dof)
        return Reading(slips, self.arms[key], torques)

    def complete(self, slips: Sequence[Slip]) -> Reading:
        """Return an arrangement with the signs and factors of its torques."""
        base = self.read(slips)
        shares, signs = base.shares, np.sign(base.torques.factor)
        turned = (shares.ratio * signs < 0) & (shares.explained > CHECK.explained_least)
        joints = list_true_joints(turned & shares.loaded(CHECK.weak_joint_share))
        tried = [base, self._turn(base, joints)] if joints else [base]
        units = self._list_factors(slips, shares)
        tried += [self.read([*reading.slips, u]) for reading in tried for u in units]
        for reading in tuple(tried):  # torques whose friction gives power, all together
            giving = list_true_joints(reading.rough.braking < -_BRAKES)
            tried += [self._turn(reading, giving)] if giving else []
        return max(tried, key=_BY_SKETCH)

    def _turn(self, reading: Reading, torques: Sequence[int]) -> Reading:
        """Return a reading with the sign of some torques reversed."""
        signs = build_sign_slips(set(), set(torques), self.robot.dof)
        return self.read([*reading.slips, *signs])

    def polish(self, reading: Reading) -> Reading:
        """Change signs, then units and channels of torques, while the evidence rises."""
        for _ in range(2 * self.robot.dof):
            for changes in (self._list_signs, self._list_torques):
                tried = list(changes(reading))
                best = max(tried, key=_BY_SKETCH, default=reading)
                if best.sketched > reading.sketched:
                    reading = best
                    break
            else:
                break
        return reading

    def _list_signs(self, reading: Reading) -> Iterator[Reading]:
        # Joints whose friction dissipates power are correct.
        odd = list_true_joints(reading.rough.braking < _BRAKES)
        yield from (self._turn(reading, [j]) for j in odd)

    def _list_torques(self, reading: Reading) -> Iterator[Reading]:
        dof, slips = self.robot.dof, list(reading.slips)
        plain = [slip for slip in slips if slip.kind not in (*_SCALED, "torque_scale")]
        plain += [slip for slip in slips if slip.kind in _SCALED and not slip.of_torques]
        shares = replace(reading.shares, ratio=np.abs(reading.shares.ratio))
        for unit in self._list_factors(slips, shares):
            yield self.read([*plain, unit])
        if len(plain) < len(slips):  # factors of some drives, not a unit of all
            yield self.read([*plain, *list_scale_slips(shares)])
        held = replace(shares, ratio=shares.ratio * np.abs(reading.torques.factor))
        for scale in list_scale_slips(held):
            if not any(slip.joints == scale.joints for slip in slips):
                yield self.read([*slips, scale])
        if not any(slip.kind == "joint_order" for slip in slips):
            moving = np.flatnonzero(self.motion.moving.any(axis=0))
            for pair in combinations(moving, 2):
                order = swap_channels(range(dof), *pair)
                yield self.read([build_order_slip(order, ("tau",)), *slips])

    def _list_factors(self, slips: Sequence[Slip], shares: NominalShares) -> list[Slip]:
        """Return slips of units; a factor with a clock slip could hide the weight."""
        clock = any(slip.kind == "time_unit" for slip in slips)
        return [] if clock else list_factor_slips(self.robot, shares)

    def _list_signs_elsewhere(self, reading: Reading) -> Iterator[Reading]:
        """Yield reversed angles in place of torques: friction shows both alike.

        Also the arm's mirror image.
        """
        angles, torques, rest = split_signs(reading.slips)
        one = angles ^ torques
        for joints in (*({j} for j in one), torques - angles, one, torques):
            if joints:
                signs = angles ^ joints, torques ^ joints
                yield self.read([*rest, *build_sign_slips(*signs, self.robot.dof)])

    def best(self) -> tuple[Reading, list[Reading]]:
        """Return the best reading, and the others tried."""
        reading = self._in_unit(self.polish(self.complete(())))
        others = [self.read(())]
        if not reading.strained:  # strain under a rough file
            bent = [*self._inclined(reading), *list_removals(self.robot)]
            tried = [self._turned(self.read([*reading.slips, s])) for s in bent]
            others += [reading, *tried]
            reading = max([reading, *tried], key=_BY_VALUE)
        reading, more = self._arranged(reading)
        others += more
        reading = self._in_unit(reading)
        while True:
            tried = list(self._list_signs_elsewhere(reading))
            better = [each for each in tried if _beats(each, reading)]
            others += tried
            if not better:
                reading, moved = self._moved(self._turned(reading))
                return reading, others + moved
            others.append(reading)
            reading = max(better, key=_BY_VALUE)

    def _arranged(self, reading: Reading) -> tuple[Reading, list[Reading]]:
        """Return the best arrangement of some slips, and the others tried.

        One of two mistakes may explain much while the strain stays as large.
        """
        sketch = Search(self.robot, self.motion.sketch(), self.speeds_agree)
        ahead, others = reading, []
        for _ in range(_DEPTH):
            if not ahead.strained:
                break
            kept = [s for s in ahead.slips if not s.of_torques]
            orders = [s for s in ahead.slips if s.of_torques and s.kind == "joint_order"]
            bases = [kept, [*kept, *orders]] if orders else [kept]
            drawn = [
                sketch.complete([*base, slip]) for base in bases for slip in self._more(ahead, kept)
            ]
            drawn.sort(key=lambda each: -each.sketched)
            tried = [self.polish(self.read(r.slips)) for r in drawn[:_POLISHED]]
            others += [*tried, ahead]
            best = ahead
            for each in sorted(tried, key=lambda each: (len(each.slips), -each.value)):
                best = each if _beats(each, best) else best
            if best is ahead:
                best = max(tried, key=_BY_VALUE, default=ahead)
                gain = best.value - ahead.value
                if ahead is not reading or gain < CHECK.suspect_nats:
                    break
            ahead = best
        return (ahead if _beats(ahead, reading) else reading), others

    def _in_unit(self, reading: Reading) -> Reading:
        """Read torques with the factor common to all loaded joints.

        Under a rough prior of small masses the evidence hardly favours it.
        """
        if any(slip.kind in _SCALED for slip in reading.slips):
            return reading
        ratio = reading.shares.ratio * reading.torques.factor
        shares = replace(reading.shares, ratio=ratio)
        units = self._list_factors(reading.slips, shares)
        read = (self.read([*reading.slips, unit]) for unit in units)
        return max(read, key=_BY_VALUE, default=reading)

    def _more(self, reading: Reading, kept: Sequence[Slip]) -> Iterator[Slip]:
        kinds = {slip.kind for slip in kept}
        once = (MOUNTING, REMOVED, "time_unit", "angle_unit", "out_of_range")
        for slip in list_arrangement_slips(self.robot, self.motion, self.speeds_agree):
            if not (slip.kind in kinds and slip.kind in once):
                yield slip
        if MOUNTING not in kinds:
            yield from self._inclined(reading)

    def _inclined(self, reading: Reading) -> Iterator[Slip]:
        if np.linalg.norm(reading.sums.gravity):
            tilted = find_tilted_gravity(reading.sums, reading.torques)
            if measure_angle(tilted, reading.sums.gravity) > CHECK.tilted_rad / 2:
                yield build_mounting_slip(self._down, tilted)

    @property
    def _down(self) -> Array:
        return np.asarray(self.robot.model.gravity.linear)

    def _turned(self, reading: Reading) -> Reading:
        """Turn gravity until no further tilt explains more."""
        if not any(slip.kind == MOUNTING for slip in reading.slips):
            return reading
        for _ in range(12):
            tilted = find_tilted_gravity(reading.sums, reading.torques)
            turn = measure_angle(tilted, reading.sums.gravity)
            slip = build_mounting_slip(self._down, tilted)
            slips = [slip if s.kind == MOUNTING else s for s in reading.slips]
            other = self.read(slips)
            if turn < 2e-3 or other.nats < reading.nats - 2.0:
                break
            reading = other
        # Arms are mounted along an axis; a load turns the estimate a little.
        gravity = reading.sums.gravity
        size = float(np.linalg.norm(gravity))
        axis = size * np.sign(gravity) * (np.abs(gravity) > 0.9 * size)
        if axis.any() and measure_angle(axis, self._down) > CHECK.tilted_rad / 2:
            slip = build_mounting_slip(self._down, axis)
            near = self.read([slip if s.kind == MOUNTING else s for s in reading.slips])
            if near.nats > reading.nats - CHECK.odds_nats:
                return near
        return reading

    def _moved(self, reading: Reading) -> tuple[Reading, list[Reading]]:
        """Shift zeros while that explains more: a quarter turn is one of many.

        Returns:
            The reading, and others with another value of a zero.
        """
        others = []
        for slip in [s for s in reading.slips if s.repairs and s.repairs[0].zero]:
            (zero,), (joint,) = slip.repairs[0].zero, slip.joints
            rest, best = [s for s in reading.slips if s is not slip], reading
            for step in _ZERO_STEPS:
                start = zero
                for way in (-step, step):
                    near = build_zero_slip(joint, start + way, exact=False)
                    if slip.kind == "out_of_range":
                        near = replace(slip, repairs=near.repairs)
                    other = self.read([*rest, near])
                    if other.nats > best.nats:
                        best, zero = other, start + way
            if best.nats > reading.nats + CHECK.odds_nats:
                reading = best
            elif best.nats > reading.nats + _ALIKE:
                others.append(best)
        return reading, others


def _beats(reading: Reading, other: Reading) -> bool:
    """Whether a reading replaces another: one more mistake must be significant."""
    if len(reading.slips) <= len(other.slips):
        return reading.value > other.value
    more = {slip.kind for slip in reading.slips} - {slip.kind for slip in other.slips}
    gain = reading.value - other.value + CHECK.odds_nats
    # A reading with the same strain explains nothing: another cause is missing.
    left, before = (np.minimum(each.strain, CHECK.certain_nats).sum() for each in (reading, other))
    eased = left < max(0.8 * before, CHECK.odds_nats)
    return gain > _find_least_gain(more) and bool(eased)


def _find_least_gain(kinds: Iterable[str]) -> float:
    """Return the least significant gain [nats]: gravity of sound arms gains 5 at most."""
    of_gravity = bool(kinds) and set(kinds) <= {MOUNTING, REMOVED}
    return 2 * CHECK.odds_nats if of_gravity else CHECK.suspect_nats


def find_misreadings(robot: Robot, motion: CheckMotion, speeds_agree: bool) -> list[Fault]:
    """Find faults of the columns, the clock, or the mounting of the arm."""
    search = Search(robot, motion, speeds_agree)
    best, others = search.best()
    if wrong := _find_wrong_robot(best):
        return [wrong]
    groups = [
        [s for s in best.slips if s.kind == k] for k in dict.fromkeys(s.kind for s in best.slips)
    ]
    decided = (_decide(search, best, others, group) for group in groups)
    faults = [fault for fault in decided if fault is not None]
    # An arrangement with unnamed factors fits too much.
    arranged, rough = len(best.arranged), [slip for slip in best.slips if slip.rough]
    if all(fault.certain for fault in faults) and not (arranged and rough):
        return faults
    # A certain fault has to leave a clean log.
    free = arranged > 1 or any(slip.of_torques for slip in rough)
    if arranged and (best.bend > CHECK.certain_nats or (free and best.strained)):
        words = f"No single fault makes this log fit the robot: another robot file, or {best.name}"
        return [_suspect_robot(best, f"{words} at once.")]
    return [replace(fault, certain=False) for fault in faults]


def _decide(
    search: Search, best: Reading, others: Sequence[Reading], group: Sequence[Slip]
) -> Fault | None:
    """Return the fault of slips of one kind; None if not significant."""
    kind, own = group[0].kind, {slip.words for slip in group}
    without = search.read([slip for slip in best.slips if slip not in group])
    gain = best.nats - without.nats
    shown = gain >= _find_least_gain([kind])
    level = measure_angle(best.sums.gravity, search._down) < CHECK.tilted_rad
    if (kind == MOUNTING and level) or kind == "out_of_range" or not (shown or kind in _SCALED):
        return None
    joints = tuple(sorted({j for slip in group for j in slip.joints}))
    repairs = tuple(repair for slip in group for repair in slip.repairs)
    told = {slip.words for slip in best.slips} - own
    near = [
        other
        for other in others
        if other.value > best.value - CHECK.odds_nats
        and other.slips
        and all(slip.kind != "out_of_range" for slip in other.slips)
        and not own <= {slip.words for slip in other.slips}
    ]
    same = [
        other
        for other in near
        if abs(other.nats - best.nats) < _ALIKE and told <= {slip.words for slip in other.slips}
    ]
    alternatives = tuple(
        tuple(r for slip in other.slips if slip.words not in told for r in slip.repairs)
        for other in same[:1]
    )
    # On the same joints they are one fault with two lines; on others they are rivals.
    where = {o: {j for s in o.slips if s.words not in told for j in s.joints} for o in same}
    one = [o for o in same if where[o] == set(joints) or abs(o.nats - best.nats) < _EQUAL]
    apart = [other for other in near if other not in one]
    rivals = [o.name if o.name != best.name else "another number of it" for o in apart]
    rivals += _list_rivals(best, without, kind)
    far, rough = True, any(slip.rough for slip in group)
    if kind in _SCALED:  # whether a wrong file cannot cause such factors
        factors = [np.log(np.abs(repair.scale)) for repair in repairs if repair.scale]
        most = np.log(CHECK.certain_ratio)
        far = max(abs(np.mean(each)) for each in factors) > most
        if not far and np.ptp(np.concatenate([np.ravel(each) for each in factors])) < most:
            rivals.insert(0, "masses of the robot file that are all off by one factor")
    certain = (
        kind not in _NEVER_CERTAIN
        and not rivals
        and not (kind == "angle_zero" and group[0].rough)
        and gain > (CHECK.suspect_nats if kind == MOUNTING else CHECK.certain_nats)
        and best.rough.braking[[j - 1 for j in joints] or slice(None)].min() > -_BRAKES
        and (kind in (*_SCALED, *SIGNS) or best.explains)
        and far
        and _count_strain(best.strain) < CHECK.certain_nats
        and best.bend < CHECK.certain_nats
    )
    if kind in _SCALED:
        certain = certain and without.bends
    else:
        certain = certain and best.fit(LOOSE).nats - without.fit(LOOSE).nats > CHECK.suspect_nats
    words = ". ".join(slip.words for slip in group)
    why = f"better by {gain:.0f} nats" if shown else "all joints under load have it"
    return Fault(
        kind,
        joints,
        bool(certain),
        f"{words}: {why}.",
        () if rough else repairs,
        alternatives=() if rough else alternatives,
        rivals=() if certain else tuple(dict.fromkeys(rivals))[:3],
        settle="" if certain else _SETTLE.get(kind, ""),
    )


_SETTLE = {
    MOUNTING: "Look at how the arm stands, or hold it still in three poses.",
    REMOVED: "Hold the arm still with a link level: does its drive show the weight?",
    "time_unit": "Log the speeds, or compare the length of the log with a clock.",
    "torque_unit": "Weigh a link, or hang a known mass on the flange.",
    "gear_ratio": "Read the gear ratios off the data sheet.",
    "torque_scale": "Hang a known mass on the flange.",
}


def _list_rivals(best: Reading, without: Reading, kind: str) -> list[str]:
    """List the causes that explain the log as given nearly as well."""
    out = []
    scales = {ROUGH: CHECK.suspect_nats, LOOSE: CHECK.odds_nats}
    if kind in _SCALED:
        del scales[LOOSE]  # bodies of any size fit any unit
    for scale, least in scales.items():
        reached = best.fit(scale).nats - least
        for name, deviations in list_other_causes(without.sums, scale).items():
            fit = fit_arm(without.sums, without.torques, deviations)
            if fit.nats > reached and is_possible(without.sums, fit):
                out.append(name)
    return out


def _count_strain(strain: Array) -> float:
    """Strain of a robot file, without its worst joint [nats]."""
    most = np.minimum(strain, CHECK.one_joint_nats)
    return float(most.sum() - most.max())


def _find_wrong_robot(best: Reading) -> Fault | None:
    """Find another arm: even the best reading strains the file beyond a rough one.

    Two joints may be odd, or have an effect; more mean another arm.
    """
    nats = _count_strain(best.strain)
    # The allowed strain is the same with other units and signs of the torques; it is
    # lower with another arrangement, or if they lack the torque of the file.
    more = len(best.arranged) + (0 if best.explains else 2)
    least = CHECK.certain_nats * (1.0, 0.5, 0.2)[min(more, 2)]
    if nats < least or not nats:
        return None
    tried = f" (the best: {best.name})" if best.slips else ""
    little = "" if best.explains else ", whose torque hardly shows in the log's"
    return _suspect_robot(
        best,
        "No reordering, sign, unit or zero makes this log fit the robot"
        f"{tried}: several joints would be far from the robot file{little} "
        f"({nats:.0f} nats without the worst joint).",
    )


def _suspect_robot(best: Reading, words: str) -> Fault:
    """Return the suspected fault: several effects, or faults, look like another arm."""
    rivals = (best.name,) if best.slips else ()
    settle = "Compare the joints' names, and the arm's type, with the robot file."
    return Fault("wrong_robot", (), False, words, rivals=rivals, settle=settle)
