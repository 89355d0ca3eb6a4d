"""Which logs separate what goals and positions alone leave open, of any motion.

The torque of a drive is gain times what is left of the way. So all torques hold up to
one factor per joint, which only a known mass fixes; at one gain a wrong motor constant
and friction are alike; and damping by the drive is friction until the drive is off.
"""

from collections.abc import Sequence

from residual.recording import Recording
from residual.robot.robot import Robot


def list_separating_logs(robot: Robot, logs: Sequence[Recording]) -> tuple[str, ...]:
    """Return what to log in addition, a sentence each; none where torque is measured.

    Args:
        logs: Those that were fitted.
    """
    driven = [log for log in logs if log.drive is not None]
    if not driven:
        return ()
    out = []
    if not any(log.enabled is not None and not log.enabled.all() for log in driven):
        out.append(
            "No log has the drive off: switch it off once while the arm moves, and log "
            "that, to separate damping by the drive from friction."
        )
    if "payload.mass" not in robot.known_values:
        out.append(
            "No mass is known: log once with a weighed load and give it with --known "
            "payload.mass=..., to fix the factor of all torques."
        )
    out.append(
        "Log the same motion at another gain, with a map of its own, to separate "
        "gain and motor constant from viscous friction."
    )
    return tuple(out)
