"""A rigid body as URDF text: bodies in principal axes, nothing to see or to touch."""

import numpy as np
import pinocchio as pin

Array = np.ndarray


def urdf_of(model: pin.Model) -> str:
    """Return a URDF with the joints and bodies of a serial arm.

    Inertias are written along their principal axes: Bullet's own diagonalisation of a
    full tensor is good to 1e-6 N m only. Ranges are left wide open.

    Args:
        model: Arm with revolute joints, joint 1 at the base.
    """
    parts = ['<?xml version="1.0"?>', '<robot name="arm">', _link(0, None)]
    for i in range(1, model.njoints):
        parts += [_link(i, model.inertias[i]), _joint(model, i)]
    return "\n".join([*parts, "</robot>"])


def joint_axis(model: pin.Model, joint: int) -> Array:
    """Return the axis of a joint in its own frame. Shape (3,)."""
    data, rest = model.createData(), pin.neutral(model)
    return pin.computeJointJacobian(model, data, rest, joint)[3:, joint - 1]


def _link(i: int, body: pin.Inertia | None) -> str:
    if body is None:
        body = pin.Inertia(1.0, np.zeros(3), np.eye(3))  # the base does not move
    moments, axes = np.linalg.eigh(body.inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    tensor = " ".join(
        f'{name}="{float(value)!r}"'
        for name, value in zip(("ixx", "iyy", "izz"), moments, strict=True)
    )
    return (
        f'<link name="link{i}"><inertial>{_origin(axes, body.lever)}'
        f'<mass value="{float(body.mass)!r}"/>'
        f'<inertia {tensor} ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def _joint(model: pin.Model, i: int) -> str:
    place = model.jointPlacements[i]
    return (
        f'<joint name="joint{i}" type="revolute"><parent link="link{i - 1}"/>'
        f'<child link="link{i}"/>{_origin(place.rotation, place.translation)}'
        f'<axis xyz="{_numbers(joint_axis(model, i))}"/>'
        '<limit lower="-1000" upper="1000" effort="0" velocity="1000"/></joint>'
    )


def _origin(rotation: Array, translation: Array) -> str:
    rpy = pin.rpy.matrixToRpy(rotation)
    return f'<origin xyz="{_numbers(translation)}" rpy="{_numbers(rpy)}"/>'


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
