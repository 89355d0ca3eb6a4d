"""A position-controlled arm: what its servos make of the goals that they are sent.

A host sends a goal with every sample of its log, the bus delivers it late, the firmware
walks towards it no faster than it may, and presses in proportion to what is left.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import asdict, replace

import numpy as np

from residual.errors import InputError
from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.plant_records import ReferenceMotion, ServoDrive


def check_servo(servo: ServoDrive | None, robot: Robot) -> None:
    """Check that each value of the servos, if there are some, is there per joint."""
    for name, values in asdict(servo or ServoDrive()).items():
        if len(values) not in (0, robot.dof):
            raise InputError(
                f"[drive] {name} has {len(values)} values, expected {robot.dof}: one "
                f"for each joint of {robot.name}."
            )


def follow_goal(servo: ServoDrive, reference: ReferenceMotion, stride: int) -> ReferenceMotion:
    """Return the motion that the servos walk along, at the rate of the controller.

    Args:
        stride: Steps of the controller from one goal of the host to the next.
    """
    dt, dof = reference.t[1] - reference.t[0], reference.q.shape[1]
    late = np.round(np.array(servo.delay or [0.0] * dof) / dt).astype(int)
    stretch = np.array(servo.goal_speed or [np.inf] * dof) * dt
    walked = np.empty_like(reference.q)
    for j in range(dof):
        place = reference.q[0, j]
        bus = deque([place] * late[j])
        for k in range(len(walked)):
            bus.append(reference.q[k - k % stride, j])
            left = bus.popleft() - place
            place += left if abs(left) <= stretch[j] else np.copysign(stretch[j], left)
            walked[k, j] = place
    return replace(reference, q=walked)


def build_servo_law(
    servo: ServoDrive, walked: ReferenceMotion
) -> Callable[[int, Array, Array, Array], Array]:
    """Return the law of servos that press towards the motion they walk along."""
    dof = walked.q.shape[1]
    gain = np.array(servo.gain or [1.0] * dof)
    most = np.array(servo.limit or [np.inf] * dof)

    def torque(k: int, reading: Array, rate: Array, demand: Array) -> Array:
        return np.minimum(np.maximum(gain * (walked.q[k] - reading), -most), most)

    return torque
