"""PyBullet: integrator of the link side; only this file imports it.

One step is exact: tau = RNEA(q_k, v_k, (v_(k+1) - v_k) / dt) to about 1e-11 N m, and
q_(k+1) = q_k + dt v_(k+1). Every setting below is needed for that.
"""

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import numpy as np
import pinocchio as pin

from residual.errors import build_missing_package_error
from residual.recording import Array
from residual.robot.dynamics import find_joint_axis
from residual.robot.files import find_prismatic_joints
from residual.robot.urdf import format_numbers

_FREE = 1e3  # rad and rad/s: limits beyond any motion


def write_model_urdf(model: pin.Model) -> str:
    """Return a URDF with the joints and bodies of a serial arm.

    Inertias are written along their principal axes: Bullet's own diagonalisation of a
    full tensor is good to 1e-6 N m only. Ranges are left wide open.
    """
    parts = ['<?xml version="1.0"?>', '<robot name="arm">', _link(0, None)]
    for i in range(1, model.njoints):
        parts += [_link(i, model.inertias[i]), _joint(model, i)]
    return "\n".join([*parts, "</robot>"])


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
    kind = "prismatic" if find_prismatic_joints(model)[i - 1] else "revolute"
    return (
        f'<joint name="joint{i}" type="{kind}"><parent link="link{i - 1}"/>'
        f'<child link="link{i}"/>{_origin(place.rotation, place.translation)}'
        f'<axis xyz="{format_numbers(find_joint_axis(model, i))}"/>'
        '<limit lower="-1000" upper="1000" effort="0" velocity="1000"/></joint>'
    )


def _origin(rotation: Array, translation: Array) -> str:
    rpy = pin.rpy.matrixToRpy(rotation)
    return f'<origin xyz="{format_numbers(translation)}" rpy="{format_numbers(rpy)}"/>'


@contextmanager
def silence_c_output() -> Iterator[None]:
    """Keep the output of C code off the terminal, its own buffer included."""
    flush = ctypes.CDLL(None).fflush
    sys.stdout.flush()
    flush(None)
    sys.stderr.flush()
    saved = {number: os.dup(number) for number in (1, 2)}
    sink = os.open(os.devnull, os.O_WRONLY)
    for number in saved:
        os.dup2(sink, number)
    try:
        yield
    finally:
        flush(None)
        for number, copy in saved.items():
            os.dup2(copy, number)
            os.close(copy)
        os.close(sink)


class _Bullet:
    """PyBullet, loaded with the first arm that is put into it.

    It is installed on Linux with Python 3.11 only; commands without a simulated arm do
    not need it.
    """

    def __getattr__(self, name: str):
        try:
            with silence_c_output():
                import pybullet
        except ImportError as error:
            raise build_missing_package_error("pybullet") from error
        # From here on names are found without a detour.
        vars(self).update(vars(pybullet))
        return getattr(pybullet, name)


bullet = _Bullet()


class BulletWorld:
    """One arm in a separate PyBullet client; use it in a with block."""

    def __init__(self, model: pin.Model, dt: float) -> None:
        self._on = {"physicsClientId": bullet.connect(bullet.DIRECT)}
        with tempfile.TemporaryDirectory() as folder, silence_c_output():
            path = Path(folder) / "arm.urdf"
            path.write_text(write_model_urdf(model), encoding="utf-8")
            flags = bullet.URDF_USE_INERTIA_FROM_FILE
            self._arm = bullet.loadURDF(str(path), useFixedBase=True, flags=flags, **self._on)
        self._joints = list(range(model.nv))
        bullet.setGravity(*model.gravity.linear.tolist(), **self._on)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=dt,
            numSubSteps=0,
            numSolverIterations=50,
            solverResidualThreshold=0,
            deterministicOverlappingPairs=1,
            **self._on,
        )
        # Dampers, limits and motors that Bullet adds by itself are switched off, one
        # property per call: combined, changeDynamics drops some of them silently.
        for link in (-1, *self._joints):
            free = {"linearDamping": 0, "angularDamping": 0}
            bullet.changeDynamics(self._arm, link, **free, **self._on)
            bullet.changeDynamics(self._arm, link, maxJointVelocity=_FREE, **self._on)
        for link in self._joints:
            limits = {"jointLowerLimit": -_FREE, "jointUpperLimit": _FREE}
            bullet.changeDynamics(self._arm, link, **limits, **self._on)
        still = [0.0] * len(self._joints)
        motors = bullet.VELOCITY_CONTROL
        bullet.setJointMotorControlArray(self._arm, self._joints, motors, forces=still, **self._on)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        bullet.disconnect(**self._on)

    def reset(self, q: Array, qd: Array) -> None:
        """Put the arm into a state."""
        for joint, position, velocity in zip(self._joints, q, qd, strict=True):
            bullet.resetJointState(self._arm, joint, position, velocity, **self._on)

    def state(self) -> tuple[Array, Array]:
        """Return positions [rad] and velocities [rad/s], shapes (dof,)."""
        states = bullet.getJointStates(self._arm, self._joints, **self._on)
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    def step(self, torque: Array) -> None:
        """Advance by one time step under these joint torques [N m]. Shape (dof,)."""
        forces, control = torque.tolist(), bullet.TORQUE_CONTROL
        bullet.setJointMotorControlArray(
            self._arm, self._joints, control, forces=forces, **self._on
        )
        bullet.stepSimulation(**self._on)
