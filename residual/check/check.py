"""From a robot and its recordings to the faults that they have."""

from collections.abc import Sequence

import numpy as np

from residual.check.body import body_faults
from residual.check.clock import time_unit, uneven
from residual.check.enough import enough
from residual.check.follow import carried
from residual.check.late import commanded, filtered, late, long_late
from residual.check.motion import thin_rows
from residual.check.physics import misread, wrong_robot
from residual.check.ranges import degrees, out_of_range, zero_explains
from residual.check.reported import exchanged, frictionless, other_torque
from residual.check.result import Fault, LogCheck
from residual.check.samples import spikes, with_scale, without_spikes, wraps
from residual.check.standing import constant, standing
from residual.check.velocity import velocity_faults
from residual.check.world import other_world
from residual.errors import InputError
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.pieces import sketch_of


def check_logs(
    robot: Robot,
    recordings: Sequence[Recording],
    declared: Sequence[str] | None = None,
) -> LogCheck:
    """Check whether logs are what they say they are.

    A fault that others follow from is reported alone: with a wrong unit of time no
    speed is too high, and with a wrong robot file nothing fits.

    Args:
        declared: Effects that the nominal model has; None for the usual ones.

    Raises:
        InputError: If there is no log.
    """
    if not recordings:
        raise InputError("No log to check: expected at least one recording, got none.")
    with np.errstate(all="ignore"):
        faults = _faults(robot, recordings, declared)
    return LogCheck(tuple(sorted(faults, key=lambda fault: not fault.certain)))


def _faults(
    robot: Robot, recordings: Sequence[Recording], declared: Sequence[str] | None
) -> list[Fault]:
    single = [(r, spikes(r)) for r in recordings]
    faults = [fault for _, found in single for fault in found]
    logs = [without_spikes(r) if found else r for r, found in single]
    clock = time_unit(robot, logs)
    if clock is not None:
        faults.append(clock)
        logs = [with_scale(r, "t", clock.repairs[0].scale) for r in logs]
    wrapped = [fault for log in logs for fault in wraps(log, robot)]
    if wrapped:
        return faults + wrapped
    dead = [fault for log in logs for fault in constant(robot, log)]
    for log in logs:
        faults += uneven(log) + standing(log)
    speeds = velocity_faults(logs)
    logs = _in_units(logs, speeds)
    turned = degrees(robot, logs)
    if turned or dead:
        # Nothing more is known of an arm without one of its angles.
        return faults + dead + carried(turned, speeds, logs)
    return faults + _of_the_arm(robot, logs, speeds, declared)


def _in_units(
    logs: Sequence[Recording], speeds: Sequence[Fault]
) -> Sequence[Recording]:
    """Mend units of time and angle that the velocities gave away."""
    for fault in speeds:
        for repair in fault.repairs:
            if repair.signal in ("t", "q") and isinstance(repair.scale, float):
                logs = [with_scale(r, repair.signal, repair.scale) for r in logs]
    return logs


def _of_the_arm(
    robot: Robot,
    logs: Sequence[Recording],
    speeds: Sequence[Fault],
    declared: Sequence[str] | None,
) -> list[Fault]:
    """What the file, the motion and its physics say; the first that is certain wins.

    Physics is the same all along a log: of long ones seven minutes are looked at.
    """
    faults, whole = body_faults(robot), logs
    logs = sketch_of(logs)
    motion = thin_rows(logs)
    faults += enough(logs, motion)
    if motion is None or any(fault.certain for fault in faults):
        return [*faults, *speeds]
    columns, reading = misread(robot, motion)
    if not any(fault.certain for fault in columns):
        columns = exchanged(robot, motion) or columns
    columns = other_torque(robot, motion, columns) or columns
    columns = columns or other_world(robot, motion) or wrong_robot(robot, motion)
    if any(fault.kind == "wrong_robot" for fault in columns):
        columns = long_late(robot, motion, logs) or columns
    if columns and zero_explains(robot, motion, logs, reading):
        return [*faults, *filtered(logs), *speeds, *out_of_range(robot, whole)]
    computed = commanded(robot, logs)
    fits = not columns
    columns += computed or filtered(logs)
    if fits and not computed:  # a command is ahead of what it makes the arm do
        columns += late(robot, motion, logs)
    if fits:
        columns += frictionless(robot, motion, declared)
    mended = any(fault.certain for fault in (*columns, *speeds))
    faults += carried(columns, speeds, logs)
    return faults if mended else faults + out_of_range(robot, whole)
