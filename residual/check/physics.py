"""Faults of the column map that the physics of the motion shows."""

from dataclasses import replace

from residual.check.motion import Motion
from residual.check.reading import GEAR, Judged, Reading, as_given, best_reading, judge
from residual.check.result import Fault, Repair
from residual.robot.robot import Robot

Joints = tuple[int, ...]

CERTAIN = 50.0  # nats that the reading given loses against the repair
# Other angles are many readings; one of them may suit an odd but healthy arm.
_CERTAIN_ANGLES = 80.0
_ANGLES = ("joint_order", "angle_sign")
_SUFFERS = 5.0  # share of the gain that one channel may lose
_WORTH = 30.0  # nats below which nothing is said


def misread(robot: Robot, motion: Motion) -> tuple[list[Fault], Reading]:
    """Find signs, orders and units that another reading of the columns explains better.

    Args:
        robot: The arm.
        motion: Rows of its logs.

    Returns:
        The faults, and the reading that mends them.
    """
    best, given = best_reading(robot, motion), as_given(robot.dof)
    if best.reading == given:
        return [], given
    court = _Court(robot, motion, best)
    parts = (_torque_unit, _angle_unit, _order, _angle_sign, _torque_sign)
    faults = [fault for part in parts if (fault := part(court))]
    return faults, best.reading if faults else given


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
            (other.fit(j - 1) - self._best.fit(j - 1) for j in joints), default=0
        )
        if nats < _WORTH or suffers > nats / _SUFFERS:
            return None
        evidence = f"{words} better by {nats:.0f} nats."
        enough = _CERTAIN_ANGLES if kind in _ANGLES else CERTAIN
        return Fault(kind, joints, nats > enough, evidence, tuple(repairs))


def _torque_unit(court: _Court) -> Fault | None:
    unit = court.reading.torque_unit
    if unit == 1.0:
        return None
    if unit == GEAR:
        return _gear(court)
    words = (
        f"The torques are about {1 / unit:g} times what this arm takes for this "
        f"motion; times {unit:g} they fit"
    )
    repairs = [Repair("tau", scale=unit)]
    return court.fault("torque_unit", (), words, repairs, torque_unit=1.0)


def _gear(court: _Court) -> Fault | None:
    """Torques of the motors: mended where the gears are known."""
    words = (
        "The torques are tens to hundreds of times smaller than what this arm takes "
        "for this motion: they look like those of the motors; times a gear ratio they "
        "fit"
    )
    gears = () if court.gears is None else tuple(float(abs(g)) for g in court.gears)
    repairs = [Repair("tau", court.joints, scale=gears)] if gears else []
    return court.fault("gear_ratio", (), words, repairs, torque_unit=1.0)


def _angle_gear(court: _Court) -> Fault | None:
    words = "The angles look like those of the motors; over the gear ratios they fit"
    scale = tuple(float(1 / abs(g)) for g in court.gears)
    repairs = [Repair("q", court.joints, scale=scale)]
    return court.fault("gear_ratio", (), words, repairs, angle_unit=1.0)


def _angle_unit(court: _Court) -> Fault | None:
    unit = court.reading.angle_unit
    if unit == 1.0:
        return None
    if unit == 1 / GEAR:
        return _angle_gear(court)
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
        f"{' and '.join(r.signal for r in repairs)} of {_joints(joints)} are those of "
        f"other joints; in the order {_list(repairs[-1].order)} they fit"
    )
    undone = {"angle_order": same, "torque_order": same}
    return court.fault("joint_order", joints, words, repairs, **undone)


def _angle_sign(court: _Court) -> Fault | None:
    angles = _turned(court.reading.angle_sign)
    if not angles:
        return None
    both = tuple(j for j in _turned(court.reading.torque_sign) if j in angles)
    repairs = [_turn("q", angles)] + ([_turn("tau", both)] if both else [])
    words = f"The angle of {_joints(angles)} counts backwards; turned, it fits"
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
        f"The torque of {_joints(joints)} has the wrong sign (friction would give "
        "power, or weight pull upwards); turned, it fits"
    )
    signs = enumerate(court.reading.torque_sign)
    undone = tuple(1 if j + 1 in joints else s for j, s in signs)
    repairs = [_turn("tau", joints)]
    return court.fault("torque_sign", joints, words, repairs, torque_sign=undone)


def _turned(signs: tuple[int, ...]) -> Joints:
    return tuple(j + 1 for j, sign in enumerate(signs) if sign < 0)


def _turn(signal: str, joints: Joints) -> Repair:
    return Repair(signal, joints, sign=(-1,) * len(joints))


def _joints(joints: Joints) -> str:
    return f"joint{'s' if len(joints) > 1 else ''} {_list(joints)}"


def _list(numbers) -> str:
    return ", ".join(str(n) for n in numbers)
