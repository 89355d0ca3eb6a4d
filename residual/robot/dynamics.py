"""Rigid-body dynamics over whole recordings.

Pinocchio does the work of one sample; here are the loops. Its order of the inertial
parameters of a link is m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz, about the link
frame.
"""

import numpy as np
import pinocchio as pin

Array = np.ndarray

PER_LINK = 10
# A mass of exactly zero has no centre; this one moves no torque by more than 1e-5 N m.
_LEAST_MASS = 1e-6


def inverse_dynamics(model: pin.Model, q: Array, qd: Array, qdd: Array) -> Array:
    """Return the joint torques of the rigid body.

    tau = M(q) qdd + C(q, qd) qd + g(q)    (paper eq. 3 without F)

    Args:
        q: Positions [rad]. Shape (n, dof).
        qd: Velocities [rad/s]. Shape (n, dof).
        qdd: Accelerations [rad/s^2]. Shape (n, dof).

    Returns:
        Torques [N m]. Shape (n, dof).
    """
    q, qd, qdd = map(_rows, (q, qd, qdd))
    data, tau = model.createData(), np.empty_like(q)
    for i in range(len(q)):
        tau[i] = pin.rnea(model, data, q[i], qd[i], qdd[i])
    return tau


def regressor(model: pin.Model, q: Array, qd: Array, qdd: Array) -> Array:
    """Return the inertial regressor: inverse_dynamics = regressor @ parameters.

    Args:
        q: Positions [rad]. Shape (n, dof).
        qd: Velocities [rad/s]. Shape (n, dof).
        qdd: Accelerations [rad/s^2]. Shape (n, dof).

    Returns:
        Regressor in SI units. Shape (n, dof, 10 * dof).
    """
    q, qd, qdd = map(_rows, (q, qd, qdd))
    data = model.createData()
    out = np.empty((len(q), model.nv, PER_LINK * model.nv))
    for i in range(len(q)):
        out[i] = pin.computeJointTorqueRegressor(model, data, q[i], qd[i], qdd[i])
    return out


def mass_matrix(model: pin.Model, q: Array) -> Array:
    """Return M(q) [kg m^2]. Shape (n, dof, dof)."""
    q = _rows(q)
    data, out = model.createData(), np.empty((len(q), model.nv, model.nv))
    for i in range(len(q)):
        out[i] = pin.crba(model, data, q[i])
    upper = np.triu(out)  # it fills no more
    return upper + np.triu(upper, 1).transpose(0, 2, 1)


def gravity_torque(model: pin.Model, q: Array, direction: Array) -> Array:
    """Return the torques that hold the arm in a given field of gravity.

    Linear in the direction; model.gravity.linear gives the g(q) of the model itself.

    Args:
        q: Positions [rad]. Shape (n, dof).
        direction: Acceleration of gravity in the base frame [m/s^2]. Shape (3,).

    Returns:
        Torques [N m]. Shape (n, dof).
    """
    q = _rows(q)
    tilted = pin.Model(model)
    tilted.gravity.linear = np.asarray(direction, dtype=float)
    data, tau = tilted.createData(), np.empty_like(q)
    for i in range(len(q)):
        tau[i] = pin.computeGeneralizedGravity(tilted, data, q[i])
    return tau


def flange_jacobian(model: pin.Model, q: Array) -> Array:
    """Return the Jacobian of the flange, the last frame of the arm.

    Rows are linear [m] then angular velocity of the flange per joint speed, along the
    axes of the base frame.

    Args:
        q: Positions [rad]. Shape (n, dof).

    Returns:
        Jacobians. Shape (n, 6, dof).
    """
    q = _rows(q)
    data, frame = model.createData(), flange_frame(model)
    out = np.empty((len(q), 6, model.nv))
    for i in range(len(q)):
        out[i] = pin.computeFrameJacobian(
            model, data, q[i], frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
    return out


def flange_frame(model: pin.Model) -> int:
    """Return the index of the last frame that the last joint moves."""
    moved = [i for i, f in enumerate(model.frames) if f.parentJoint == model.nv]
    return moved[-1]


def flange_placement(model: pin.Model) -> pin.SE3:
    """Return where the flange sits in the frame of the last joint."""
    return model.frames[flange_frame(model)].placement


def joints_length(model: pin.Model) -> float:
    """Return the way from the base over all joints to the last one [m]."""
    return float(sum(np.linalg.norm(p.translation) for p in model.jointPlacements))


def reach(model: pin.Model) -> float:
    """Return the way from the base over all joints to the flange [m]."""
    return joints_length(model) + float(
        np.linalg.norm(flange_placement(model).translation)
    )


def inertial_parameters(model: pin.Model) -> Array:
    """Return the ten parameters of every moving body, in SI units. (10 * dof,)."""
    bodies = list(model.inertias)[1:]
    return np.concatenate([body.toDynamicParameters() for body in bodies])


def with_inertial_parameters(model: pin.Model, parameters: Array) -> pin.Model:
    """Return a copy of the model with other inertial parameters.

    Values that no body can have (negative mass or inertia) are taken as they are.

    Args:
        parameters: Ten per moving body, in SI units. Shape (10 * dof,).
    """
    changed = pin.Model(model)
    for i, body in enumerate(np.reshape(parameters, (-1, PER_LINK)), start=1):
        body = np.array(body, dtype=float)
        if abs(body[0]) < _LEAST_MASS:
            body[0] = _LEAST_MASS
        changed.inertias[i] = pin.Inertia.FromDynamicParameters(body)
    return changed


def _rows(values: Array) -> Array:
    return np.ascontiguousarray(values, dtype=float)
