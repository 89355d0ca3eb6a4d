"""PyBullet as the integrator of the link side; the only file that imports it.

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

import numpy as np
import pinocchio as pin

from sim.plant.urdf import urdf_of


@contextmanager
def silence() -> Iterator[None]:
    """Keep what C prints off the terminal, its own buffer included."""
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


with silence():
    import pybullet as bullet

Array = np.ndarray

_FREE = 1e3  # rad and rad/s: limits that nothing reaches


class World:
    """One arm in one physics client; close it, or use it in a with block.

    Args:
        model: Rigid body of the arm, gravity included.
        dt: Time step [s].
    """

    def __init__(self, model: pin.Model, dt: float) -> None:
        self._joints = list(range(model.nv))
        self._client = bullet.connect(bullet.DIRECT)
        self._on = {"physicsClientId": self._client}
        bullet.setGravity(*model.gravity.linear.tolist(), **self._on)
        self._arm = self._load(urdf_of(model))
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=dt,
            numSubSteps=0,
            numSolverIterations=50,
            solverResidualThreshold=0,
            deterministicOverlappingPairs=1,
            **self._on,
        )
        self._set_free()

    def _load(self, urdf: str) -> int:
        with tempfile.TemporaryDirectory() as folder, silence():
            path = Path(folder) / "arm.urdf"
            path.write_text(urdf, encoding="utf-8")
            flags = bullet.URDF_USE_INERTIA_FROM_FILE
            return bullet.loadURDF(
                str(path), useFixedBase=True, flags=flags, **self._on
            )

    def _set_free(self) -> None:
        """Switch off dampers, limits and motors that Bullet adds by itself."""
        # One property per call: combined, changeDynamics drops some of them silently.
        for link in (-1, *self._joints):
            free = {"linearDamping": 0, "angularDamping": 0}
            bullet.changeDynamics(self._arm, link, **free, **self._on)
            bullet.changeDynamics(self._arm, link, maxJointVelocity=_FREE, **self._on)
        for link in self._joints:
            limits = {"jointLowerLimit": -_FREE, "jointUpperLimit": _FREE}
            bullet.changeDynamics(self._arm, link, **limits, **self._on)
        still = [0.0] * len(self._joints)
        motors = bullet.VELOCITY_CONTROL
        bullet.setJointMotorControlArray(
            self._arm, self._joints, motors, forces=still, **self._on
        )

    def reset(self, q: Array, qd: Array) -> None:
        """Put the arm into a state."""
        for joint, position, velocity in zip(self._joints, q, qd, strict=True):
            bullet.resetJointState(self._arm, joint, position, velocity, **self._on)

    def state(self) -> tuple[Array, Array]:
        """Return positions [rad] and velocities [rad/s], shapes (dof,)."""
        states = bullet.getJointStates(
            self._arm, self._joints, physicsClientId=self._client
        )
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    def step(self, torque: Array) -> None:
        """Go on by one time step under these joint torques [N m]. Shape (dof,)."""
        bullet.setJointMotorControlArray(
            self._arm,
            self._joints,
            bullet.TORQUE_CONTROL,
            forces=torque.tolist(),
            physicsClientId=self._client,
        )
        bullet.stepSimulation(physicsClientId=self._client)

    def close(self) -> None:
        """Let go of the physics client."""
        bullet.disconnect(**self._on)

    def __enter__(self) -> "World":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
