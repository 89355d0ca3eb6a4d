"""Possible mistakes of a column map or a robot file, one by one.

Each is a hypothesis: its repair is applied to the data, and is also the line that the
user receives.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from threading import Lock

import numpy as np
import pinocchio as pin
from cachetools import LRUCache, cached

from residual.check.evidence import CheckMotion, NominalShares, Torques
from residual.check.result import MOUNTING, REMOVED, Repair, list_true_joints
from residual.check.thresholds import CHECK
from residual.errors import format_joint_numbers, join_with_commas
from residual.recording import Array
from residual.robot.dynamics import build_motion_key
from residual.robot.robot import Robot

SIGNS = ("angle_sign", "torque_sign")
GEAR = 100.0  # a typical gear ratio: motor torques are smaller by this factor
_TIMES = (0.1, 0.5, 2.0, 10.0)  # true time over given time
_TURNS = (-np.pi / 2, np.pi / 2, np.pi)
_ANGLE_UNITS = {np.pi / 180: "degrees", 180 / np.pi: "radians that were taken for degrees"}
# N m per unit: N mm, kN m, N cm, kgf cm.
TORQUE_UNITS = (1e-3, 1e3, 1e-2, 0.0980665)


@dataclass(frozen=True, slots=True)
class Slip:
    """One mistake, with its repair."""

    kind: str  # of the fault
    joints: tuple[int, ...]  # from 1; () for all
    words: str  # a clause that describes it
    repairs: tuple[Repair, ...]
    odds: float = 1.0  # log odds against it, in multiples of those of one mistake
    rough: bool = False  # whether its numbers are too rough for a line of a map

    @property
    def of_torques(self) -> bool:
        """Whether it concerns torques only, so that the Gram matrix is reused."""
        return all(repair.signal == "tau" for repair in self.repairs)


@cached(LRUCache(32), key=lambda robot, g: build_motion_key(robot, np.array(g, float)), lock=Lock())
def copy_with_gravity(robot: Robot, gravity: Sequence[float] | Array) -> Robot:
    """Return the arm under another gravity [m/s^2]. (3,)."""
    model = pin.Model(robot.model)
    model.gravity.linear = np.asarray(gravity, dtype=float)
    return replace(robot, model=model)


def repair_motion(
    robot: Robot, motion: CheckMotion, repairs: Sequence[Repair]
) -> tuple[Robot, CheckMotion]:
    """Apply repairs of angles, clock and gravity to a motion of all logs."""
    for repair in repairs:
        if repair.gravity is not None:
            robot = copy_with_gravity(robot, repair.gravity)
        elif repair.signal == "t":
            scale = float(repair.scale)
            motion = replace(motion, qd=motion.qd / scale, qdd=motion.qdd / scale**2)
        elif repair.signal == "q":
            order = [i - 1 for i in repair.order or range(1, motion.dof + 1)]
            motion = motion.reorder_angles(order, compute_factors(repair, motion.dof))
            if repair.zero is not None:
                shift = np.zeros(motion.dof)
                shift[[j - 1 for j in repair.joints]] = repair.zero
                motion = replace(motion, q=motion.q - shift)
    return robot, motion


def repair_torques(repairs: Sequence[Repair], dof: int) -> Torques:
    """Return the reading of torques with repairs."""
    order, factor = np.arange(dof), np.ones(dof)
    for repair in repairs:
        if repair.signal == "tau":
            if repair.order is not None:
                own = [i - 1 for i in repair.order]
                order, factor = order[own], factor[own]
            factor = factor * compute_factors(repair, dof)
    return Torques(order, factor)


def compute_factors(repair: Repair, dof: int) -> Array:
    """Return sign times scale of a repair, joint by joint. Shape (dof,)."""
    out = np.ones(dof)
    at = [j - 1 for j in repair.joints] or slice(None)
    out[at] = np.multiply(repair.sign or 1, repair.scale or 1)
    return out


def list_arrangement_slips(robot: Robot, motion: CheckMotion, speeds_agree: bool) -> Iterator[Slip]:
    """Yield slips of order, sign, unit, zero, clock and direction of gravity.

    Args:
        speeds_agree: Whether logged speeds match the derivative of the angles.
    """
    dof = robot.dof
    # If one of two joints stands still, they show no order.
    stands = ~motion.moving.any(axis=0)
    for slip in _list_orders(robot):
        if not stands[[j - 1 for j in slip.joints]].any():
            yield slip
    for joints in [{j + 1} for j in range(dof)] + [set(range(1, dof + 1))]:
        yield from build_sign_slips(joints, set(), dof)
        yield from build_sign_slips(joints, joints, dof)
    for j in np.flatnonzero(~np.asarray(robot.prismatic)):
        yield from (build_zero_slip(int(j) + 1, turn) for turn in _TURNS)
    yield from _list_shifts(robot, motion)
    for factor, what in _ANGLE_UNITS.items():
        words = f"The angles look like {what}; times {factor:.6g} they fit"
        yield Slip("angle_unit", (), words, (Repair("q", scale=factor),))
    if robot.gear_ratio is not None:
        every = tuple(range(1, dof + 1))
        gears = tuple(float(1 / abs(g)) for g in robot.gear_ratio)
        words = "The angles look like those of the motors; by the gears they fit"
        yield Slip("gear_ratio", (), words, (Repair("q", every, scale=gears),))
    for factor in () if speeds_agree else _TIMES:
        words = f"With time times {factor:g} weight and inertia go together"
        yield Slip("time_unit", (), words, (Repair("t", scale=factor),))
    down = np.asarray(robot.model.gravity.linear)
    size = float(np.linalg.norm(down))
    if size:
        for axis in size * np.vstack([np.eye(3), -np.eye(3)]):
            if axis @ down < np.cos(CHECK.tilted_rad / 2) * size**2:
                yield build_mounting_slip(down, axis)
    yield from list_removals(robot)


def list_removals(robot: Robot) -> Iterator[Slip]:
    """Yield the slip of a driver that removes the arm's weight from the torque."""
    if np.linalg.norm(robot.model.gravity.linear):
        words = (
            "Without the weight that the robot file gives the arm the torques are its "
            "own: the driver took gravity out before it was logged, or the arm is "
            "balanced by counterweights or springs. If the driver did, log the torque "
            "as measured, or say so in robot.toml, [robot]: gravity = [0, 0, 0]"
        )
        yield Slip(REMOVED, (), words, ())


def measure_angle(a: Array, b: Array) -> float:
    """Angle between two directions [rad]; zero if one vanishes."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.arccos(np.clip(a @ b / size, -1, 1))) if size else 0.0


def build_mounting_slip(file: Array, gravity: Array) -> Slip:
    """Return the slip of an arm mounted differently from its file."""
    angle = measure_angle(file, gravity)
    way = f"stands inclined by {np.degrees(angle):.0f} degrees"
    for at, words in ((np.pi, "hangs from a ceiling"), (np.pi / 2, "is on a wall")):
        way = words if abs(angle - at) < CHECK.tilted_rad else way
    one, other = (join_with_commas(g + 0.0, ".3g") for g in (file, gravity))
    words = (
        f"Gravity points along {one} in the robot file; along {other} m/s^2 the "
        f"torques fit: the arm {way}"
    )
    repair = Repair("robot", gravity=tuple(map(float, gravity)))
    return Slip(MOUNTING, (), words, (repair,))


def _list_orders(robot: Robot) -> Iterator[Slip]:
    """Yield orders: two joints exchanged, all reversed, shifted by one, or alphabetic."""
    names, same = robot.joints, tuple(range(robot.dof))
    places = sorted(names)
    orders = {swap_channels(same, *pair) for pair in combinations(same, 2)}
    orders |= {tuple(places.index(name) for name in names), same[::-1]}
    orders |= {(*same[1:], same[0]), (same[-1], *same[:-1])}
    for order in sorted(orders - {same}):
        yield from (build_order_slip(order, signals) for signals in _SIGNALS)
    for a, b, c in permutations(same, 3):
        if a < min(b, c):  # three joints in a ring, each once
            ring = swap_channels(swap_channels(same, a, b), b, c)
            yield build_order_slip(ring, _SIGNALS[0])


_SIGNALS = (("q", "tau"), ("tau",), ("q",))


def build_order_slip(order: Sequence[int], signals: Sequence[str]) -> Slip:
    """Return the slip of signals in the columns of other joints (channels from 0)."""
    by_name = tuple(int(i) + 1 for i in order)
    joints = tuple(j for j, i in enumerate(by_name, 1) if i != j)
    words = (
        f"{' and '.join(signals)} of {format_joint_numbers(joints)} are those of other "
        f"joints; in the order {join_with_commas(by_name)} they fit"
    )
    repairs = tuple(Repair(signal, order=by_name) for signal in signals)
    # Angle and torque of a joint exchanged together are one mistake, not two.
    return Slip("joint_order", joints, words, repairs, _count_order_odds(joints))


def _count_order_odds(joints: Sequence[int]) -> float:
    """Odds against an order, which grow with the number of moved joints."""
    return 1.5 + 0.25 * len(joints)


def _merge_orders(slips: Sequence[Slip]) -> list[Slip]:
    """Return slips with all exchanges of channels merged into one, or none."""
    orders = {"q": None, "tau": None}
    for slip in slips:
        for repair in slip.repairs if slip.kind == "joint_order" else ():
            last = orders[repair.signal] or range(len(repair.order))
            orders[repair.signal] = [last[i - 1] for i in repair.order]
    moved = {k: x for k, x in orders.items() if x and x != sorted(x)}
    rest = [slip for slip in slips if slip.kind != "joint_order"]
    if not moved:
        return rest
    one, *other = moved.values()
    if not other or other == [one]:
        return [build_order_slip(one, tuple(moved)), *rest]
    parts = [build_order_slip(order, (name,)) for name, order in moved.items()]
    joints = tuple(sorted({j for part in parts for j in part.joints}))
    words = " and ".join(part.words for part in parts)
    repairs = tuple(r for part in parts for r in part.repairs)
    odds = 1.0 + _count_order_odds(joints)
    return [Slip("joint_order", joints, words, repairs, odds), *rest]


def build_zero_slip(joint: int, zero: float, exact: bool = True) -> Slip:
    """Return the slip of a joint (from 1) with a given angle at its zero [rad]."""
    about = "" if exact else "about "
    words = (
        f"The zero of joint {joint} is {about}{abs(np.degrees(zero)):.0f} degrees off; "
        "moved, it fits"
    )
    repair = Repair("q", (joint,), zero=(float(zero),))
    return Slip("angle_zero", (joint,), words, (repair,), rough=not exact)


def _list_shifts(robot: Robot, motion: CheckMotion) -> Iterator[Slip]:
    """Yield other zeros of the only joint whose angles exceed their range."""
    low, high = motion.q.min(axis=0), motion.q.max(axis=0)
    beyond = np.maximum(robot.lower - low, high - robot.upper) > CHECK.range_rad
    fits = high - low < robot.upper - robot.lower + CHECK.range_rad
    joints = list_true_joints(beyond & fits)
    if len(joints) == 1:
        j = joints[0] - 1
        first, last = robot.lower[j] - low[j], robot.upper[j] - high[j]
        for shift in np.linspace(first, last, min(16, 2 + int(abs(last - first) / 0.3))):
            slip = build_zero_slip(joints[0], -float(shift))
            yield replace(slip, kind="out_of_range", words="", odds=1.2)


def swap_channels(order: Sequence[int], a: int, b: int) -> tuple[int, ...]:
    """Return an order with two of its joints (from 0) exchanged."""
    out = list(order)
    out[a], out[b] = out[b], out[a]
    return tuple(out)


def build_sign_slips(angles: set[int], torques: set[int], dof: int) -> list[Slip]:
    """Return the slips of angles and torques with the opposite sign.

    A joint with both is mounted upside down: one mistake.
    """
    both = angles & torques
    parts = (
        ("angle_sign", angles - both, ("q",), "The angle", 0.1),
        ("angle_sign", both, ("q", "tau"), "Angle and torque", 0.5),
        ("torque_sign", torques - both, ("tau",), "The torque", 0.0),
    )
    out = []
    for kind, joints, signals, what, extra in parts:
        if joints:
            where = tuple(sorted(joints))
            words = (
                f"{what} of {format_joint_numbers(where)} has the other sign (friction "
                "would give power, or weight pull upwards); turned, it fits"
            )
            repairs = tuple(Repair(x, where, sign=(-1,) * len(where)) for x in signals)
            # Reversing several or all joints of one signal is one mistake.
            odds = 0.5 + 0.5 * min(len(where), 1 + dof - len(where)) + extra
            out.append(Slip(kind, where, words, repairs, odds))
    return out


def split_signs(slips: Sequence[Slip]) -> tuple[set[int], set[int], list[Slip]]:
    """Return the joints with reversed angles, with reversed torques, and other slips.

    Joints are numbered after all exchanges of channels, which may follow a sign.
    """
    turned: dict[str, set[int]] = {"q": set(), "tau": set()}
    for slip in slips:
        for repair in slip.repairs:
            if slip.kind in SIGNS:
                turned[repair.signal] ^= set(repair.joints)
            elif repair.order is not None:
                places, before = enumerate(repair.order, 1), turned[repair.signal]
                turned[repair.signal] = {j for j, i in places if i in before}
    rest = [slip for slip in slips if slip.kind not in SIGNS]
    return turned["q"], turned["tau"], rest


def merge_slips(slips: Sequence[Slip], dof: int) -> tuple[Slip, ...]:
    """Return the slips with all orders merged and first, and all signs last."""
    angles, torques, rest = split_signs(slips)
    return (*_merge_orders(rest), *build_sign_slips(angles, torques, dof))


def list_torque_units(robot: Robot) -> Iterator[Slip]:
    """Yield named units of all torques, and those by factors of the file."""
    for unit in TORQUE_UNITS:
        words = (
            f"The torques are about {1 / unit:g} times what this arm takes for this "
            f"motion; times {unit:g} they fit"
        )
        yield Slip("torque_unit", (), words, (Repair("tau", scale=unit),))
    joints = tuple(range(1, robot.dof + 1))
    for kind, factors in (("gear_ratio", robot.gear_ratio), ("torque_unit", robot.torque_per_unit)):
        if factors is not None:
            what = "those of the motors" if kind == "gear_ratio" else "currents"
            words = f"The torques look like {what}; by the factors of robot.toml they fit"
            scale = tuple(float(abs(f)) for f in factors)
            yield Slip(kind, (), words, (Repair("tau", joints, scale=scale),))


def list_factor_slips(robot: Robot, shares: NominalShares) -> list[Slip]:
    """Return the slips of torques in another unit that their shares suggest.

    Named units nearby, one factor for all, and a factor of each drive. The joints that
    carry the arm decide: at a wrist a rough file may be off by any factor. None if one
    of them has the right share.
    """
    sharp = shares.ratio_sd < CHECK.ratio_sd * np.abs(shares.ratio)
    shows = sharp & (shares.explained > CHECK.explained_least)
    few, size = min(2, len(shows)), np.abs(shares.ratio)
    strong = shows & shares.loaded()
    if strong.sum() < few:  # of the strongest, one may hide an effect
        strong = shows & shares.loaded(CHECK.weak_joint_share)
    own = size[strong]
    if len(own) < few or (own.max() > 1 / CHECK.unit_ratio and (own.min() < CHECK.unit_ratio)):
        return []
    sure = shows & shares.loaded(CHECK.weak_joint_share)
    middle = float(np.median(1 / own))
    each = np.where(sure, 1 / np.maximum(size, 1e-300), middle)
    shown = np.flatnonzero(sure)
    out = []
    for unit in list_torque_units(robot):
        away = np.abs(np.log(np.abs(unit.repairs[0].scale) / each))
        if np.median(away[strong]) < np.log(CHECK.unit_ratio):
            out.append(unit)
    if any(unit.repairs[0].joints for unit in out):
        return out  # factors in the robot file need no estimate
    if each[shown].max() < CHECK.factor_spread * each[shown].min():
        told = f"about {float(f'{middle:.2g}'):g}"
    else:
        told = "about " + ", ".join(f"{float(f'{each[j]:.2g}'):g} (joint {j + 1})" for j in shown)
    silent = np.flatnonzero(~sure) + 1
    if len(silent):
        told += f"; too little shows of {format_joint_numbers(silent)}"
    out.append(_build_factor_slip(np.full(len(each), middle), told, 1.5))
    in_place = np.abs(np.log(each[shown])) < np.log(CHECK.unit_ratio)
    if each[shown].max() > CHECK.factor_spread * each[shown].min() and not any(in_place):
        # Separate factors are less likely than a common one; next to a drive with the
        # right unit they are those of single drives.
        out.append(_build_factor_slip(each, told, 3.0))
    return out


def _build_factor_slip(factors: Array, told: str, odds: float) -> Slip:
    words = (
        f"Expected torques in N m, got values that fit this arm only times {told}"
        ": currents of the motors, torque before the gears, or the file of an arm of "
        "another size. Give the drives' own N m per logged unit (torque constant times "
        "gear ratio) where they are known: torque_per_unit = [...] in robot.toml, "
        '[joints], and unit = "A" in the line tau of --map'
    )
    scale = tuple(float(f"{f:.2g}") for f in factors)
    repair = Repair("tau", tuple(range(1, len(scale) + 1)), scale=scale)
    kind = "gear_ratio" if np.median(factors) > GEAR / 3 else "torque_unit"
    return Slip(kind, (), words, (repair,), odds, rough=True)


def list_scale_slips(shares: NominalShares) -> Iterator[Slip]:
    """Yield a factor of the torque of one joint while others have the right one."""
    sharp = shares.ratio_sd < CHECK.ratio_sd * np.abs(shares.ratio)
    shows = sharp & (shares.explained > CHECK.explained_well) & shares.loaded()
    for j in np.flatnonzero(shows & (shares.ratio > 0)):
        factor = float(f"{1 / shares.ratio[j]:.2g}")
        if 0.15 < factor < 7 and abs(np.log(factor)) > np.log(CHECK.gain_ratio):
            words = (
                f"The torque of joint {j + 1} fits times {factor:g}: another torque "
                "constant or gear ratio of this drive"
            )
            repair = Repair("tau", (int(j) + 1,), scale=(factor,))
            slip = Slip("torque_scale", (int(j) + 1,), words, (repair,), 1.5)
            yield replace(slip, rough=True)
