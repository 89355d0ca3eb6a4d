"""From a robot and its recordings to the faults that they have."""

from collections.abc import Sequence

from residual.check.motion import thin_rows
from residual.check.physics import misread
from residual.check.result import Fault, LogCheck
from residual.check.samples import spikes
from residual.recording import Recording
from residual.robot.robot import Robot


def check_logs(
    robot: Robot,
    recordings: Sequence[Recording],
    declared: Sequence[str] | None = None,
) -> LogCheck:
    """Check whether logs are what they say they are.

    Args:
        robot: The arm.
        recordings: Its logs, all read with one column map.
        declared: Effects that the nominal model has; None for the usual ones.

    Returns:
        The faults, certain ones first.
    """
    faults = [fault for r in recordings for fault in spikes(r)]
    if not faults:
        faults += _physics(robot, recordings)
    return LogCheck(tuple(sorted(faults, key=lambda fault: not fault.certain)))


def _physics(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    motion = thin_rows(recordings)
    return [] if motion is None else misread(robot, motion)[0]
