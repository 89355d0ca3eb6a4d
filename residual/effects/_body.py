"""A rigid body that a link carries besides its own: ten parameters, in some frame.

The coefficients are m, m c and the inertia about the origin of the link's joint, in
Pinocchio's order (xx, xy, yy, xz, yz, zz); reports give mass, centre, and the inertia
about that centre, in the axes of a frame fixed to the link.
"""

from dataclasses import replace

import numpy as np

PARAMETERS = {
    "mass": "kg",
    "com_x": "m",
    "com_y": "m",
    "com_z": "m",
    "ixx": "kg m^2",
    "ixy": "kg m^2",
    "ixz": "kg m^2",
    "iyy": "kg m^2",
    "iyz": "kg m^2",
    "izz": "kg m^2",
}
LEAST = 0.01  # of the arm's mass: a lighter body has no determined centre
ARM = 0.1  # m from the frame to the centre of a typical body


def columns(state, joints, shape):
    """The regressor of the link that carries it. Shape (n, dof, 10)."""
    (link,) = joints
    regressor = state.regressor
    if state.robot.carried is not None:  # what is added, nothing holds
        from residual.robot.dynamics import LazyRegressor

        free = replace(state.robot, carried=None)
        regressor = LazyRegressor(free, (state.q, state.qd, state.qdd))
    return regressor[:, :, 10 * link : 10 * link + 10]


def values_in(placement, theta):
    """Mass, centre and inertia about that centre, in the axes of a frame. Shape (10,).

    Args:
        placement: The frame, in that of the link's joint.
    """
    mass = theta[0] if abs(theta[0]) > 1e-9 else 1e-9
    centre = theta[1:4] / mass
    xx, xy, yy, xz, yz, zz = theta[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    shift = centre @ centre * np.eye(3) - np.outer(centre, centre)
    rotation = placement.rotation
    inertia = rotation.T @ (about_origin - mass * shift) @ rotation
    com = rotation.T @ (centre - placement.translation)
    return np.array([theta[0], *com, *inertia[np.triu_indices(3)]])


def theta_from(placement, values):
    """The inverse of `values_in`; there is no shape."""
    import pinocchio as pin

    xx, xy, xz, yy, yz, zz = values[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    point = placement.act(pin.Inertia(values[0], values[1:4], np.zeros((3, 3))))
    # Computed directly: a change of a load need not have the inertia of a body.
    own = placement.rotation @ inertia @ placement.rotation.T
    theta = point.toDynamicParameters()
    theta[4:] += own[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return theta, ()


def usual_in(placement):
    """A kilogram a hand's breadth off a frame, in any direction."""
    ways = ARM * np.concatenate([np.eye(3), -np.eye(3)])
    bodies = [np.array([1.0, *way, *np.zeros(6)]) for way in ways]
    return [theta_from(placement, body)[0] for body in bodies]


def prior_sd(robot):
    """Up to 8 % of the arm's mass, a fifth of a metre off the joint's origin.

    For an arm of one joint, up to all of its mass, which is mostly the load.
    """
    share = 0.08 if robot.dof > 1 else 1.0
    mass = share * sum(body.mass for body in robot.model.inertias)
    return np.array([mass] + 3 * [0.2 * mass] + 6 * [0.03 * mass])


def is_parameter_reportable(key, values, stds):
    """Report inertia only if determined: positive, and known within a third."""
    if not key.startswith("i"):
        return True
    principal = [4, 7, 9]
    return bool(np.all(values[principal] > 3 * stds[principal]))


def possible(theta, limits, lightest):
    """No heavier than the arm, no lighter than a mass [kg], and within reach."""
    mass, turn = theta[0], np.linalg.norm(theta[1:4])
    least = LEAST if limits.load_mass_seen else 1.0
    near = turn < limits.reach * max(abs(mass), least * limits.weight)
    return bool(lightest <= mass < limits.weight and near)


def bodies(theta, joints, robot):
    """The inertial parameters that it adds. Shape (10 dof,)."""
    out = np.zeros((robot.dof, 10))
    out[list(joints)] = theta
    return out.ravel()
