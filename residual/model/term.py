"""One effect of a model, with its coefficients."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from residual.effects import registry
from residual.effects._tables import TABLES
from residual.effects.base import Effect, Joints, Shape, State
from residual.names import check_name
from residual.recording import Array
from residual.robot.robot import Robot


@dataclass(frozen=True, eq=False, slots=True)
class Term:
    """One effect on given joints with its coefficients.

    Attributes:
        effect: The effect.
        joints: Joints it sits on, from 0.
        shape: Its nonlinear parameters.
        theta: Coefficients of its columns. Shape (k,).
    """

    effect: Effect
    joints: Joints
    shape: Shape
    theta: Array

    def torque(self, state: State) -> Array:
        """Torque of this effect on all joints [N m]. Shape (n, dof)."""
        dof = state.q.shape[1]
        out = np.zeros((len(state.t), dof))
        rows = list(self.effect.rows(self.joints, dof))
        out[:, rows] = self.effect.columns(state, self.joints, self.shape) @ self.theta
        return out

    def parameters(self, robot: Robot) -> dict[str, float]:
        """Physical parameters by key, in the units of the effect."""
        values = self.effect.values(self.theta, self.shape, robot)
        return dict(zip(self.effect.parameters, map(float, values), strict=True))

    def to_record(self) -> dict:
        """The term as plain values; joints from 1."""
        return {
            "name": self.effect.name,
            "joints": [j + 1 for j in self.joints],
            "shape": [float(x) for x in self.shape],
            "theta": self.theta.tolist(),
        }

    @classmethod
    def from_record(cls, record: Mapping) -> "Term":
        """The way back."""
        known = registry() | TABLES
        effect = known[check_name(record["name"], known, "effect")]
        joints = tuple(j - 1 for j in record["joints"])
        return cls(effect, joints, tuple(record["shape"]), np.array(record["theta"]))
