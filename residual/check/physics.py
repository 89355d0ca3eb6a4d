"""Faults of the column map that the physics of the motion shows."""

from dataclasses import replace

import numpy as np

from residual.check.motion import Motion
from residual.check.reading import Judged, Reading, as_given, best_reading, judge
from residual.check.result import Fault, Repair
from residual.check.rules import CHECK
from residual.names import joints_listed, listed
from residual.robot.robot import Robot

Joints = tuple[int, ...]

_ANGLES = ("joint_order", "angle_sign")


def misread(robot: Robot, motion: Motion) -> tuple[list[Fault], Reading]:
    """Find signs, orders and units that another reading of columns explains better."""
    best, given = best_reading(robot, motion), as_given(robot.dof)
    if best.reading == given:
        return [], given
    was = judge(robot, motion, given)
    if best.value - was.value < CHECK.gain:
        return [], given
    court = _Court(robot, motion, best)
    parts = (_gear, _torque_unit, _angle_unit, _order, _angle_sign, _torque_sign)
    faults = [fault for part in parts if (fault := part(court))]
    if best.value - was.value < CHECK.certain:
        faults = [replace(fault, certain=False) for fault in faults]
    if not faults:
        return [], given
    # Motors whose gears are not known are no other arm.
    unknown = robot.gear_ratio is None and {f.kind for f in faults} == {"gear_ratio"}
    fits = bent(was) < CHECK.bent
    wrong = [] if unknown or fits else _wrong_robot(best, faults)
    wrong = _in_every_part(robot, motion, best.reading, wrong)
    return wrong or faults, best.reading


def wrong_robot(robot: Robot, motion: Motion) -> list[Fault]:
    """Find columns that are read rightly, but are not of this arm."""
    reading = as_given(robot.dof)
    found = _wrong_robot(judge(robot, motion, reading), [])
    return _in_every_part(robot, motion, reading, found)


def _in_every_part(
    robot: Robot, motion: Motion, reading: Reading, found: list[Fault]
) -> list[Fault]:
    """Doubt a wrong robot that some part of the logs speaks against.

    Another arm is one from the first sample to the last. Where a part fits, signals
    lost their step on the way: a block of one of them was dropped.
    """
    if not found:
        return found
    strains = [bent(judge(robot, part, reading)) for part in motion.split(CHECK.parts)]
    fits = [s < min(CHECK.bent, CHECK.part_fits * max(strains)) for s in strains]
    if not any(fits):
        return found
    words = (
        f"{found[0].evidence} Yet {sum(fits)} of {CHECK.parts} parts of the logs fit: "
        "were samples of one signal lost on the way?"
    )
    return [replace(found[0], certain=False, evidence=words)]


def _wrong_robot(best: Judged, faults: list[Fault]) -> list[Fault]:
    """Another arm, where even the best reading bends the file beyond a rough one.

    Two joints may be odd, or hide an effect; more are another arm.
    """
    nats = bent(best)
    kinds = len({fault.kind for fault in faults})
    if nats + CHECK.per_kind * max(kinds - 1, 0) < (
        CHECK.bent if kinds else CHECK.bent_as_given
    ):
        return []
    tried = f" (the best: {', '.join(sorted({f.kind for f in faults}))})"
    words = (
        "In no order, sign or unit of its columns is this the log of this robot"
        f"{tried if kinds else ''}: masses and inertias of several joints would have "
        f"to be far from the robot file, {nats:.0f} nats beside the worst of them."
    )
    certain = nats > CHECK.broken or any(fault.certain for fault in faults)
    return [Fault("wrong_robot", (), certain, words)]


def bent(judged: Judged) -> float:
    """By how much a robot file must bend, its worst joint left out [nats]."""
    strains = np.minimum(judged.strains(), CHECK.one_joint)
    return float(strains.sum() - strains.max())


class _Court:
    """The best reading, and what is lost by undoing a part of it."""

    def __init__(self, robot: Robot, motion: Motion, best: Judged) -> None:
        self._robot, self._motion, self._best = robot, motion, best
        self.gears, self.joints = robot.gear_ratio, tuple(range(1, robot.dof + 1))
        self.reading, self.same = best.reading, as_given(robot.dof)

    def fault(
        self, kind: str, joints: Joints, words: str, repairs, **undone
    ) -> Fault | None:
        """Return the fault if the reading without its repair is worse by enough."""
        other = judge(self._robot, self._motion, replace(self.reading, **undone))
        nats = self._best.nats - other.nats
        # A mistake of the map made all of its joints worse: mended, none may suffer.
        suffers = max(
            other.fit(j - 1) - self._best.fit(j - 1) for j in joints or self.joints
        )
        # What is said of all joints must be true of each.
        most = (
            nats / CHECK.suffers if joints else min(nats / CHECK.suffers, CHECK.worth)
        )
        if nats < CHECK.worth or suffers > most:
            return None
        evidence = f"{words} better by {nats:.0f} nats."
        enough = CHECK.certain_angles if kind in _ANGLES else CHECK.certain
        return Fault(kind, joints, nats > enough, evidence, tuple(repairs))


def _torque_unit(court: _Court) -> Fault | None:
    unit = court.reading.torque_unit
    if unit in (1.0, CHECK.gear):
        return None
    words = (
        f"The torques are about {1 / unit:g} times what this arm takes for this "
        f"motion; times {unit:g} they fit"
    )
    repairs = [Repair("tau", scale=unit)]
    return court.fault("torque_unit", (), words, repairs, torque_unit=1.0)


def _gear(court: _Court) -> Fault | None:
    """Signals of the motors: mended where the gears are known."""
    undone, repairs, words, gears = {}, [], [], court.gears
    known = () if gears is None else tuple(float(abs(g)) for g in gears)
    if court.reading.torque_unit == CHECK.gear:
        undone["torque_unit"] = 1.0
        words.append(
            "The torques are tens to hundreds of times smaller than this arm's"
        )
        repairs += [Repair("tau", court.joints, scale=known)] if known else []
    if court.reading.angle_unit == 1 / CHECK.gear:
        undone["angle_unit"] = 1.0
        words.append("The angles are tens to hundreds of times larger than this arm's")
        scale = tuple(1 / gear for gear in known)
        repairs.append(Repair("q", court.joints, scale=scale))
    if not undone:
        return None
    text = (
        f"{'. '.join(words)}: they look like those of the motors; by the gears they fit"
    )
    return court.fault("gear_ratio", (), text, repairs, **undone)


def _angle_unit(court: _Court) -> Fault | None:
    unit = court.reading.angle_unit
    if unit in (1.0, 1 / CHECK.gear):
        return None
    what = "degrees" if unit < 1 else "radians that were taken for degrees"
    words = f"The angles look like {what}; times {unit:.6g} they fit"
    repairs = [Repair("q", scale=unit)]
    return court.fault("angle_unit", (), words, repairs, angle_unit=1.0)


def _order(court: _Court) -> Fault | None:
    reading, same = court.reading, court.same.angle_order
    orders = {"q": reading.angle_order, "tau": reading.torque_order}
    repairs = [
        Repair(signal, order=tuple(i + 1 for i in order))
        for signal, order in orders.items()
        if order != same
    ]
    if not repairs:
        return None
    joints = tuple(j + 1 for j in same if any(o[j] != j for o in orders.values()))
    words = (
        f"{' and '.join(r.signal for r in repairs)} of {joints_listed(joints)} "
        f"are those of other joints; in the order {listed(repairs[-1].order)} they fit"
    )
    undone = {"angle_order": same, "torque_order": same}
    return court.fault("joint_order", joints, words, repairs, **undone)


def _angle_sign(court: _Court) -> Fault | None:
    angles = _turned(court.reading.angle_sign)
    if not angles:
        return None
    both = tuple(j for j in _turned(court.reading.torque_sign) if j in angles)
    repairs = [_turn("q", angles)] + ([_turn("tau", both)] if both else [])
    words = f"The angle of {joints_listed(angles)} counts backwards; turned, it fits"
    signs = enumerate(court.reading.torque_sign)
    undone = {
        "angle_sign": court.same.angle_sign,
        "torque_sign": tuple(1 if j + 1 in both else s for j, s in signs),
    }
    return court.fault("angle_sign", angles, words, repairs, **undone)


def _torque_sign(court: _Court) -> Fault | None:
    angles = _turned(court.reading.angle_sign)
    joints = tuple(j for j in _turned(court.reading.torque_sign) if j not in angles)
    if not joints:
        return None
    words = (
        f"The torque of {joints_listed(joints)} has the wrong sign (friction would "
        "give power, or weight pull upwards); turned, it fits"
    )
    signs = enumerate(court.reading.torque_sign)
    undone = tuple(1 if j + 1 in joints else s for j, s in signs)
    repairs = [_turn("tau", joints)]
    return court.fault("torque_sign", joints, words, repairs, torque_sign=undone)


def _turned(signs: tuple[int, ...]) -> Joints:
    return tuple(j + 1 for j, sign in enumerate(signs) if sign < 0)


def _turn(signal: str, joints: Joints) -> Repair:
    return Repair(signal, joints, sign=(-1,) * len(joints))
