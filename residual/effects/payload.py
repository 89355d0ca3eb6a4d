"""A load on the flange that the model does not have, or has wrong."""

import numpy as np
import pinocchio as pin

from residual.effects.base import Effect, Portable
from residual.robot.dynamics import flange_placement

LEAST = 0.01  # of the arm's mass: a load whose centre is not known from its mass
ARM = 0.1  # m from the flange to the centre of a usual load


def _columns(state, joints, shape):
    (flange,) = joints
    return state.regressor[:, :, 10 * flange : 10 * flange + 10]


def _values(theta, shape, robot):
    """Mass, centre and inertia about that centre, in the flange frame.

    ``theta`` is m, m·c and the inertia about the origin of the last joint's frame
    in Pinocchio's order: xx, xy, yy, xz, yz, zz.
    """
    mass = theta[0] if abs(theta[0]) > 1e-9 else 1e-9
    placement = flange_placement(robot.model)
    centre = theta[1:4] / mass
    xx, xy, yy, xz, yz, zz = theta[4:]
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    shift = centre @ centre * np.eye(3) - np.outer(centre, centre)
    rotation = placement.rotation
    inertia = rotation.T @ (about_origin - mass * shift) @ rotation
    com = rotation.T @ (centre - placement.translation)
    return np.array([theta[0], *com, *inertia[np.triu_indices(3)]])


def _combined(theta, robot):
    """Mass times centre, about the last joint: what gravity on slow motion shows."""
    return {
        f"mass * centre_{axis} about the last joint": (float(theta[1 + i]), "kg m")
        for i, axis in enumerate("xyz")
    }


def _from_values(values, robot):
    """The way back: a body given in the flange frame, as theta; no shape."""
    placement = flange_placement(robot.model)
    xx, xy, xz, yy, yz, zz = values[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    point = placement.act(pin.Inertia(values[0], values[1:4], np.zeros((3, 3))))
    # Added by hand: a change of a load need not have the inertia of a body.
    own = placement.rotation @ inertia @ placement.rotation.T
    theta = point.toDynamicParameters()
    theta[4:] += own[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return theta, ()


def _prior_sd(robot):
    """Up to 8 % of the arm's mass, a fifth of a metre off the joint's origin."""
    mass = 0.08 * sum(body.mass for body in robot.model.inertias)
    return np.array([mass] + 3 * [0.2 * mass] + 6 * [0.03 * mass])


def _reports(key, values, stds):
    """Inertia only where the motion shows it: positive, and known within a third."""
    if not key.startswith("i"):
        return True
    principal = [4, 7, 9]
    return bool(np.all(values[principal] > 3 * stds[principal]))


def _usual(states, joints):
    """A kilogram a hand's breadth off the flange, in any direction."""
    ways = ARM * np.concatenate([np.eye(3), -np.eye(3)])
    bodies = [np.array([1.0, *way, *np.zeros(6)]) for way in ways]
    return [_from_values(body, states[0].robot)[0] for body in bodies]


def _possible(theta, shape, limits):
    """No heavier than the arm, no lighter than the load the model has, within reach."""
    mass, turn = theta[0], np.linalg.norm(theta[1:4])
    lightest = limits.had[0] if len(limits.had) else 0.0
    near = turn < limits.reach * max(abs(mass), LEAST * limits.weight)
    return bool(-lightest <= mass < limits.weight and near)


def _bodies(theta, joints, robot):
    out = np.zeros(10 * robot.dof)
    out[-10:] = theta
    return out


EFFECT = Effect(
    name="payload",
    noun="a payload",
    place="at the flange",
    sentence="a load on the flange that the model does not have",
    equation=(
        "tau = Y_flange(q, qd, qdd) * (mass, mass * com, inertia about the flange)"
    ),
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
    scope="flange",
    values=_values,
    from_values=_from_values,
    is_parameter=True,
    carries="body",
    needs_known_body=True,
    if_refuted="was the load mounted otherwise there?",
    prior_sd=_prior_sd,
    combined=_combined,
    usual=_usual,
    reports=_reports,
    variable=None,
    possible=_possible,
    portable=Portable(bodies=_bodies),
    frame="in the axes of {flange}, from its origin; inertia about the centre",
)
