"""What a program gets and returns for a case, and the linear model of two peers.

Angles are low-passed without phase and differentiated; torque and columns pass the same
filter and are thinned out (Gautier 1997). Rows of a joint that hardly moves are left
out, since dry friction there is not determined.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from scipy.signal import butter, sosfiltfilt

from benchmarks.hidden.score import Name
from residual.recording import Array, Recording
from residual.robot.robot import Robot


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """What anybody may know of one case."""

    robot: Robot  # the arm as its maker states it
    fit: tuple[Recording, ...]  # find it in these


@dataclass(frozen=True, eq=False, slots=True)
class Answer:
    """What a program says of one case."""

    # Of each finding its name, then what it may be instead
    findings: tuple[tuple[Name, ...], ...]
    # Whether, or on which joints, something is left that has no name
    unknown: bool | list[int] = False


CUTOFF, THIN = 10.0, 10  # Hz; samples of which one is kept
STANDS = 0.02  # rad/s
STEEP = 0.01  # rad/s, of the smooth sign
BODY = 10  # parameters of a body
DRIVES = ("coulomb", "viscous", "rotor_inertia")
_KEYS = {"coulomb": "level", "viscous": "coefficient", "rotor_inertia": "inertia"}


@dataclass(frozen=True, eq=False, slots=True)
class Rows:
    """One log as equations."""

    columns: Array  # torque of each parameter of size one. Shape (m, dof, p).
    # Measured torque less that of the given model [N m]. Shape (m, dof).
    residual: Array
    moving: Array  # whether a joint moves. Shape (m, dof).


@dataclass(frozen=True)
class Arm:
    """The given model: ten parameters of each body, three of each drive, a force."""

    case: Case

    @cached_property
    def model(self) -> pin.Model:
        """The rigid body."""
        model = pin.buildModelFromXML(self.case.robot.urdf)
        model.gravity.linear = self.case.robot.model.gravity.linear
        return model

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.model.nq

    @property
    def nominal(self) -> Array:
        """Parameters as given; the force at the flange is zero. Shape (p,)."""
        bodies = [b.toDynamicParameters() for b in list(self.model.inertias)[1:]]
        declared: Mapping = json.loads(self.case.robot.toml).get("declared", {})
        drives = [declared.get(n, {}).get(_KEYS[n], [0.0] * self.dof) for n in DRIVES]
        return np.concatenate([*bodies, *drives, np.zeros(3)])

    def places(self, kind: str, joint: int) -> list[int]:
        """Return places of "body", one of DRIVES, or "force" at a joint from 1."""
        n = self.dof
        if kind == "body":
            return list(range(BODY * (joint - 1), BODY * joint))
        if kind == "force":
            return list(range(13 * n, 13 * n + 3))
        return [BODY * n + DRIVES.index(kind) * n + joint - 1]

    def columns(self, log: Recording) -> tuple[Array, Array]:
        """Return torque columns and velocities at all samples of a log."""
        n, rate = self.dof, 1 / np.median(np.diff(log.t))
        q = low_pass(log.q, rate)
        qd = np.gradient(q, axis=0) * rate
        qdd = np.gradient(qd, axis=0) * rate
        out, data = np.zeros((len(q), n, 13 * n + 3)), self.model.createData()
        for row, state in zip(out, zip(q, qd, qdd, strict=True), strict=True):
            known = pin.computeJointTorqueRegressor(self.model, data, *state)
            row[:, : BODY * n] = known
            jacobian = pin.computeJointJacobian(self.model, data, state[0], n)
            turn = data.oMi[n].rotation
            row[:, 13 * n :] = (turn @ jacobian[:3]).T
        for k, values in enumerate((np.tanh(qd / STEEP), qd, qdd)):
            for j in range(n):
                out[:, j, (BODY + k) * n + j] = values[:, j]
        return out, qd

    def rows(self, log: Recording) -> Rows:
        """Return a log with torque as equations, filtered and thinned out."""
        columns, qd = self.columns(log)
        rate = 1 / np.median(np.diff(log.t))
        residual = log.tau - columns @ self.nominal
        flat = np.concatenate([columns.reshape(len(qd), -1), residual], axis=1)
        kept = low_pass(flat, rate)[THIN:-THIN:THIN]
        p = columns.shape[1] * columns.shape[2]
        moving = np.abs(qd[THIN:-THIN:THIN]) > STANDS
        return Rows(kept[:, :p].reshape(-1, *columns.shape[1:]), kept[:, p:], moving)


def low_pass(values: Array, rate: float) -> Array:
    """Return signals through a low pass without phase, along the first axis."""
    return sosfiltfilt(butter(4, CUTOFF, fs=rate, output="sos"), values, axis=0)
