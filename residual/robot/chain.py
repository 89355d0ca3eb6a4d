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

    def origins(self, q: Array) -> Array:
        """Return the origins of base, joints and flange in the base frame [m].

        All postures at once; one axis after the other, by Rodrigues' formula.

        Args:
            q: Positions [rad]. Shape (n, dof).

        Returns:
            Shape (n, dof + 2, 3).
        """
        n, dof = q.shape
        out, turned = np.zeros((n, dof + 2, 3)), np.broadcast_to(np.eye(3), (n, 3, 3))
        for j in range(dof):
            out[:, j + 1] = out[:, j] + turned @ self.place[j]
            about = np.cross(self.axis[j], np.eye(3)).T  # v -> axis x v
            angle = q[:, j, None, None]
            turn = np.eye(3) + np.sin(angle) * about
            turn = turn + (1 - np.cos(angle)) * (about @ about)
            turned = turned @ (self.rotation[j] @ turn)
        out[:, -1] = out[:, -2] + turned @ self.flange
        return out


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
