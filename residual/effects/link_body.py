"""A body on a link that the model does not have: a valve block, a dress pack."""

import numpy as np
import pinocchio as pin

from residual.effects.base import Effect, Portable

ARM = 0.1  # m from the joint's origin to the centre of a usual body
LEAST = 0.01  # of the arm's mass: a body whose centre is not known from its mass


def _columns(state, joints, shape):
    (link,) = joints
    return state.regressor[:, :, 10 * link : 10 * link + 10]


def _values(theta, shape, robot):
    """Mass, centre and inertia about that centre, in the axes of the link's joint."""
    mass = theta[0] if abs(theta[0]) > 1e-9 else 1e-9
    centre = theta[1:4] / mass
    xx, xy, yy, xz, yz, zz = theta[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    shift = centre @ centre * np.eye(3) - np.outer(centre, centre)
    inertia = about_origin - mass * shift
    return np.array([theta[0], *centre, *inertia[np.triu_indices(3)]])


def _from_values(values, robot):
    xx, xy, xz, yy, yz, zz = values[4:]
    point = pin.Inertia(values[0], np.asarray(values[1:4]), np.zeros((3, 3)))
    theta = point.toDynamicParameters()
    theta[4:] += np.array([xx, xy, yy, xz, yz, zz])
    return theta, ()


def _prior_sd(robot):
    """Up to 8 % of the arm's mass, a fifth of a metre off the joint's origin."""
    mass = 0.08 * sum(body.mass for body in robot.model.inertias)
    return np.array([mass] + 3 * [0.2 * mass] + 6 * [0.03 * mass])


def _possible(theta, shape, limits):
    """Lighter than the arm, heavier than nothing, and within its reach."""
    mass, turn = theta[0], np.linalg.norm(theta[1:4])
    near = turn < limits.reach * max(abs(mass), LEAST * limits.weight)
    return bool(abs(mass) < limits.weight and near)


def _usual(states, joints):
    """A kilogram a hand's breadth off the joint, in any direction."""
    ways = ARM * np.concatenate([np.eye(3), -np.eye(3)])
    bodies = [np.array([1.0, *way, *np.zeros(6)]) for way in ways]
    return [_from_values(body, states[0].robot)[0] for body in bodies]


def _bodies(theta, joints, robot):
    out = np.zeros((robot.dof, 10))
    out[list(joints)] = theta
    return out.ravel()


EFFECT = Effect(
    name="link_body",
    noun="a body",
    place="on {links}",
    sentence="a body on a link that the model does not have",
    equation="tau = Y_link(q, qd, qdd) * (mass, mass * com, inertia about the joint)",
    parameters={
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
    },
    columns=_columns,
    scope="link",
    outermost=2,  # what sits on the wrist is told as a load
    values=_values,
    from_values=_from_values,
    is_parameter=True,
    in_every_model=True,
    needs_known_body=True,
    prior_sd=_prior_sd,
    usual=_usual,
    variable=None,
    possible=_possible,
    portable=Portable(bodies=_bodies),
)
