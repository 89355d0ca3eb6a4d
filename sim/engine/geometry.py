"""Clearance of an arm from the floor and itself, and joint angles for a pose.

The arm is taken as capsules between the frames of its joints, all of one thickness, a
share of the arm's length. This is coarse: it omits bulky wrists, tools and cables.
The floor is the plane z = 0 of the base frame, for arms with a vertical first axis only;
the mounting of an arm with a horizontal first axis is unknown.

Joint angles are found by Newton steps from a guess. An arm with more than six joints
reaches a pose in many ways. Along a path it stays in the plane of joint space through a
home posture, normal to the null motion of that posture. So a pose has one solution near
home, and a closed path of poses gives a closed path of joints.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space

from residual.errors import InputError
from residual.recording import Array
from residual.robot.dynamics import (
    KinematicChain,
    build_kinematic_chain,
    compute_flange_jacobian,
    find_flange_axis,
    find_flange_frame,
)
from residual.robot.robot import Robot

MARGIN = 0.02  # m, kept free
_THICKNESS = 0.07  # radius as a share of the stretched arm; 8 cm for an IRB 140
_SAME = 0.02  # of the stretched arm: closer frames count as one point
POSE_JOINTS = 6
NEAR_SINGULAR = 0.03  # least singular value of the Jacobian, of its largest
_STEPS, _LONGEST = 80, 0.4  # rad
_EXACT = 1e-11  # error of the pose [m, rad]
_DAMPING = 1e-9


@dataclass(frozen=True, eq=False, slots=True)
class ArmCapsules:
    """The capsules of an arm and their checks."""

    chain: KinematicChain  # where the joints sit
    # Which of base, joints 1 to dof and flange (0 to dof + 1) are ends of capsules;
    # capsule i runs from end i to end i + 1.
    kept: tuple[int, ...]
    radius: float  # radius of all capsules [m]
    low: tuple[int, ...]  # ends that must stay above the floor, as indices into `kept`
    pairs: tuple[tuple[int, int], ...]  # capsules that must stay apart
    names: tuple[str, ...]  # subject of each check, the floor first


def build_arm_capsules(model: pin.Model) -> ArmCapsules:
    """Return the capsules of an arm.

    Neighbours are not checked, nor capsules so close in the chain that they always
    touch.
    """
    chain = build_kinematic_chain(model)
    at_rest = chain.compute_joint_origins(np.zeros((1, model.nv)))[0]
    lengths = np.linalg.norm(np.diff(at_rest, axis=0), axis=1)
    reach = lengths.sum()
    kept, gap = [0], 0.0
    for i, length in enumerate(lengths, start=1):
        gap += length
        if gap > _SAME * reach:
            kept.append(i)
            gap = 0.0
    radius = _THICKNESS * reach
    sizes = np.linalg.norm(np.diff(at_rest[kept], axis=0), axis=1)
    pairs = tuple(
        (i, j)
        for j in range(len(sizes))
        for i in range(j - 1)
        if sizes[i + 1 : j].sum() > 3 * radius
    )
    low = tuple(k for k, frame in enumerate(kept) if frame >= 3 or frame > model.nv)
    data = model.createData()
    jacobian = pin.computeJointJacobians(model, data, pin.neutral(model))
    # Pinocchio gives a matrix of one column as a vector.
    if abs(jacobian.reshape(6, -1)[5, 0]) <= 0.99:
        low = ()  # the first axis is not upright in the base frame
    names = [f"{_end(model, kept[k])} above the floor" for k in low]
    names += [f"{_piece(model, kept, j)} from {_piece(model, kept, i)}" for i, j in pairs]
    return ArmCapsules(chain, tuple(kept), float(radius), low, pairs, tuple(names))


def compute_clearances(capsules: ArmCapsules, q: Array) -> Array:
    """Return the clearance of every check of the arm.

    Returns:
        Distances between surfaces, less than 0 where they cross [m]. Shape
        (n, checks).
    """
    ends = compute_capsule_ends(capsules, q)
    columns = [ends[:, k, 2] - capsules.radius for k in capsules.low]
    for i, j in capsules.pairs:
        between = _distance(ends[:, i], ends[:, i + 1], ends[:, j], ends[:, j + 1])
        columns.append(between - 2 * capsules.radius)
    return np.array(columns).reshape(-1, len(q)).T


def compute_capsule_ends(capsules: ArmCapsules, q: Array) -> Array:
    """Return the ends of the capsules in the base frame [m]. Shape (n, ends, 3)."""
    return capsules.chain.compute_joint_origins(np.asarray(q, dtype=float))[:, capsules.kept]


def _distance(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return the distances of segments a-b and c-d. Shapes (n, 3), result (n,).

    Ericson, Real-Time Collision Detection, section 5.1.9.
    """
    first, second, apart = b - a, d - c, a - c
    aa, ee = _dot(first, first), _dot(second, second)
    ab, ac, ef = _dot(first, second), _dot(first, apart), _dot(second, apart)
    area = aa * ee - ab**2
    s = np.where(area > 1e-12, (ab * ef - ac * ee) / np.maximum(area, 1e-12), 0.0)
    t = (ab * np.clip(s, 0, 1) + ef) / ee
    t = np.clip(t, 0, 1)
    s = np.clip((ab * t - ac) / aa, 0, 1)
    nearest = apart + s[:, None] * first - t[:, None] * second
    return np.sqrt(_dot(nearest, nearest))


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("ni,ni->n", a, b)


def _end(model: pin.Model, frame: int) -> str:
    return "the flange" if frame > model.nv else f"joint {frame}"


def _piece(model: pin.Model, kept: list[int], i: int) -> str:
    start = "the base" if kept[i] == 0 else _end(model, kept[i])
    return f"{start} to {_end(model, kept[i + 1])}"


@dataclass(frozen=True, eq=False, slots=True)
class ToolKinematics:
    """The data of an arm for inverse kinematics."""

    model: pin.Model
    flange: int  # index of the flange frame
    length: float  # length of the stretched arm [m]
    tool: Array  # direction in which a tool points, in the flange frame, (3,)


def build_tool_kinematics(robot: Robot, family: str) -> ToolKinematics:
    """Return the kinematics of a robot."""
    if robot.dof < POSE_JOINTS:
        raise InputError(
            f"{family} leads the tool through poses in space and needs {POSE_JOINTS} "
            f"joints, {robot.name} has {robot.dof}. Choose fourier or move_stop_move."
        )
    model = robot.model
    steps = [model.jointPlacements[j].translation for j in range(1, model.njoints)]
    steps.append(model.frames[find_flange_frame(model)].placement.translation)
    length = float(sum(np.linalg.norm(step) for step in steps))
    return ToolKinematics(model, find_flange_frame(model), length, find_flange_axis(model))


def compute_flange_pose(arm: ToolKinematics, q: Array) -> pin.SE3:
    """Return the pose of the flange at one posture. Shape of q (dof,)."""
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    return pin.SE3(pin.updateFramePlacement(arm.model, data, arm.flange))


def solve_inverse_kinematics(
    arm: ToolKinematics, target: pin.SE3, guess: Array, home: Array | None = None
) -> Array | None:
    """Return joint angles that bring the flange to a pose.

    Args:
        guess: Joint angles to start from [rad]. Shape (dof,).
        home: Posture that fixes redundant joints [rad]; None for the solution that
            Newton's method finds. Shape (dof,).

    Returns:
        Joint angles, ranges not considered [rad], or None if no solution was found
        from there. Shape (dof,).
    """
    model, q = arm.model, np.array(guess, dtype=float)
    data, fixed = model.createData(), np.zeros((0, model.nv))
    if home is not None and model.nv != POSE_JOINTS:
        # Null motions of the flange at home. Shape (redundant joints, dof).
        fixed = null_space(compute_flange_jacobian(model, home[None])[0]).T
    for _ in range(_STEPS):
        pin.forwardKinematics(model, data, q)
        rows = pin.computeFrameJacobian(model, data, q, arm.flange).reshape(6, -1)
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


def solve_pose_path(
    arm: ToolKinematics, targets: list[pin.SE3], start: Array, home: Array
) -> Array | None:
    """Return joint angles along a path of poses, each found from the one before.

    Args:
        start: Joint angles near the first [rad]. Shape (dof,).
        home: Posture that fixes redundant joints [rad]. Shape (dof,).

    Returns:
        Joint angles [rad], None where the path leaves reach or the arm would jump.
        Shape (n, dof).
    """
    path, last = [], start
    for target in targets:
        found = solve_inverse_kinematics(arm, target, last, home)
        if found is None or (path and np.abs(found - last).max() > _LONGEST):
            return None
        path.append(found)
        last = found
    return np.array(path)


def measure_singularity_distance(arm: ToolKinematics, q: Array) -> Array:
    """Return how far postures are from a singular one.

    The least singular value of the Jacobian over its largest, metres counted in arm
    lengths.

    Returns:
        From 0 (singular) to 1. Shape (n,).
    """
    jacobian = compute_flange_jacobian(arm.model, q)
    jacobian[:, :3] /= arm.length
    values = np.linalg.svd(jacobian, compute_uv=False)
    return values[:, -1] / values[:, 0]
