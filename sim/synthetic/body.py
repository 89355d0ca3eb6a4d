"""The true rigid body: the nominal one scattered; and its flange."""

import numpy as np
import pinocchio as pin

from residual.robot.dynamics import flange_placement

Array = np.ndarray


def scatter(model: pin.Model, relative: float, rng: np.random.Generator) -> pin.Model:
    """Return a copy whose bodies differ a little from the nominal ones.

    Mass and centre of mass are scaled, and each body is stretched about its centre:
    the second moment S = tr(I)/2 1 - I becomes s D S D with diagonal D. So the
    pseudo-inertia stays positive definite where it was: a body can be like that.
    """
    true = pin.Model(model)
    for i in range(1, true.njoints):
        body = true.inertias[i]
        factors = 1.0 + relative * rng.normal(size=7)
        mass, lever = factors[0] * body.mass, factors[1:4] * body.lever
        stretch = np.diag(factors[4:7])
        moment = np.trace(body.inertia) / 2 * np.eye(3) - body.inertia
        moment = factors[0] * stretch @ moment @ stretch
        inertia = np.trace(moment) * np.eye(3) - moment
        true.inertias[i] = pin.Inertia(mass, lever, inertia)
    return true


def outward(model: pin.Model) -> Array:
    """Return the axis of the last joint in the flange frame, pointing away. (3,).

    Away is where the flange lies from the last joint, else where its link's mass is.
    """
    data, last = model.createData(), model.njoints - 1
    jacobian = pin.computeJointJacobian(model, data, pin.neutral(model), last)
    axis = jacobian[3:, -1]
    flange = flange_placement(model)
    for direction in (flange.translation, model.inertias[last].lever):
        along = float(direction @ axis)
        if abs(along) > 1e-6:
            axis = np.sign(along) * axis
            break
    return flange.rotation.T @ axis
