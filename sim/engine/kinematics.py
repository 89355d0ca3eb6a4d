"""Joint angles for a pose of the flange, by Newton steps from a guess.

An arm with more than six joints reaches a pose in many ways. Along a path it keeps to
the plane, in the space of its joints, through a home posture and square to the motion
that leaves the flange of that posture at rest. So a pose has one answer near home, and
a closed path of poses gives a closed path of joints.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space

from residual.errors import InputError
from residual.robot.dynamics import flange_frame, flange_jacobian
from residual.robot.robot import Robot
from sim.synthetic.body import outward

Array = np.ndarray

POSE_JOINTS = 6
NEAR_SINGULAR = 0.03  # least singular value of the Jacobian, of its largest
_STEPS, _LONGEST = 80, 0.4  # rad
_EXACT = 1e-11  # error of the pose [m, rad]
_DAMPING = 1e-9


@dataclass(frozen=True, eq=False, slots=True)
class Kinematics:
    """What inverse kinematics needs to know of an arm.

    Attributes:
        model: Pinocchio model.
        flange: Index of the flange frame.
        length: Length of the stretched arm [m].
        tool: Direction in which a tool points, in the flange frame. Shape (3,).
    """

    model: pin.Model
    flange: int
    length: float
    tool: Array


def kinematics(robot: Robot, family: str) -> Kinematics:
    """Return the kinematics of a robot.

    Raises:
        InputError: If the arm has too few joints to reach any pose.
    """
    if robot.dof < POSE_JOINTS:
        raise InputError(
            f"{family} leads the tool through poses in space and needs "
            f"{POSE_JOINTS} joints, {robot.name} has {robot.dof}. Choose fourier or "
            "move_stop_move."
        )
    model = robot.model
    steps = [model.jointPlacements[j].translation for j in range(1, model.njoints)]
    steps.append(model.frames[flange_frame(model)].placement.translation)
    length = float(sum(np.linalg.norm(step) for step in steps))
    return Kinematics(model, flange_frame(model), length, outward(model))


def pose(arm: Kinematics, q: Array) -> pin.SE3:
    """Return where the flange is at one posture. Shape of q (dof,)."""
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    return pin.SE3(pin.updateFramePlacement(arm.model, data, arm.flange))


def inverse(
    arm: Kinematics, target: pin.SE3, guess: Array, home: Array | None = None
) -> Array | None:
    """Return joint angles that bring the flange to a pose.

    Args:
        target: Pose of the flange in the base frame.
        guess: Joint angles to start from [rad]. Shape (dof,).
        home: Posture that decides what spare joints do [rad]; None for the answer
            that Newton's method finds. Shape (dof,).

    Returns:
        Joint angles, ranges not considered [rad], or None if no solution was found
        from there. Shape (dof,).
    """
    model, q = arm.model, np.array(guess, dtype=float)
    data, fixed = model.createData(), _self_motion(arm, home)
    for _ in range(_STEPS):
        pin.forwardKinematics(model, data, q)
        rows = pin.computeFrameJacobian(model, data, q, arm.flange)
        here = pin.updateFramePlacement(model, data, arm.flange)
        error = pin.log6(here.actInv(target)).vector
        if len(fixed):
            rows = np.vstack([rows, fixed])
            error = np.concatenate([error, fixed @ (home - q)])
        if np.abs(error).max() < _EXACT:
            return q
        square = rows @ rows.T + _DAMPING * np.eye(len(rows))
        step = rows.T @ np.linalg.solve(square, error)
        q += step * min(1.0, _LONGEST / np.abs(step).max())
    return None


def _self_motion(arm: Kinematics, home: Array | None) -> Array:
    """Return what leaves the flange at rest at home. Shape (spare joints, dof)."""
    if home is None or arm.model.nv == POSE_JOINTS:
        return np.zeros((0, arm.model.nv))
    return null_space(flange_jacobian(arm.model, home[None])[0]).T


def follow(
    arm: Kinematics, targets: list[pin.SE3], start: Array, home: Array
) -> Array | None:
    """Return joint angles along a path of poses, each found from the one before.

    Args:
        start: Joint angles near the first [rad]. Shape (dof,).
        home: Posture that decides what spare joints do [rad]. Shape (dof,).

    Returns:
        Joint angles [rad], None where the path leaves reach or the arm would jump.
        Shape (n, dof).
    """
    path, last = [], start
    for target in targets:
        found = inverse(arm, target, last, home)
        if found is None or (path and np.abs(found - last).max() > _LONGEST):
            return None
        path.append(found)
        last = found
    return np.array(path)


def dexterity(arm: Kinematics, q: Array) -> Array:
    """Return how far postures are from a singular one.

    The least singular value of the Jacobian over its largest, metres counted in arm
    lengths.

    Args:
        q: Joint angles [rad]. Shape (n, dof).

    Returns:
        From 0 (singular) to 1. Shape (n,).
    """
    jacobian = flange_jacobian(arm.model, q)
    jacobian[:, :3] /= arm.length
    values = np.linalg.svd(jacobian, compute_uv=False)
    return values[:, -1] / values[:, 0]
