"""Where the joints of an arm sit and about which axes they turn."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.recording import Array
from residual.robot.dynamics import flange_placement


@dataclass(frozen=True, eq=False, slots=True)
class Chain:
    """Kinematics of a serial arm of revolute joints.

    Attributes:
        rotation: Frame of each joint in the one before, at angle zero. (dof, 3, 3).
        place: Its origin in the one before [m]. Shape (dof, 3).
        axis: Unit vector that it turns about, in its own frame. Shape (dof, 3).
        flange: Origin of the flange in the frame of the last joint [m]. Shape (3,).
        flange_rotation: Its axes in that frame. Shape (3, 3).
    """

    rotation: Array
    place: Array
    axis: Array
    flange: Array
    flange_rotation: Array


def chain_of(model: pin.Model) -> Chain:
    """Return the kinematics of a Pinocchio model."""
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(model.nq))
    axes = [
        pin.getJointJacobian(model, data, i, pin.ReferenceFrame.LOCAL)[3:, i - 1]
        for i in range(1, model.njoints)
    ]
    placements = list(model.jointPlacements)[1:]
    flange = flange_placement(model)
    return Chain(
        np.array([p.rotation for p in placements]),
        np.array([p.translation for p in placements]),
        np.array(axes),
        np.array(flange.translation),
        np.array(flange.rotation),
    )
