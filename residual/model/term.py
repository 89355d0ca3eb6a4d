"""One effect of a model, with its coefficients."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from residual.effects import TABLES, registry
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
        nominal: The same effect as the nominal model has it; None where it has not.
    """

    effect: Effect
    joints: Joints
    shape: Shape
    theta: Array
    nominal: "Term | None" = None

    def as_nominal(self) -> "Term":
        """The same as a part of a nominal model, to which an edit goes back."""
        return replace(self, nominal=replace(self, nominal=None))

    def torque(self, state: State) -> Array:
        """Torque of this effect on all joints [N m]. Shape (n, dof)."""
        out = np.zeros(state.q.shape)
        self.add_to(out, state)
        return out

    def add_to(self, torque: Array, state: State) -> None:
        """Add the torque of this effect to that of others [N m]. Shape (n, dof)."""
        columns = self.effect.columns(state, self.joints, self.shape)
        for row, j in enumerate(self.effect.rows(self.joints, torque.shape[1])):
            torque[:, j] += columns[:, row] @ self.theta

    def parameters(self, robot: Robot) -> dict[str, float]:
        """Physical parameters by key, in the units of the effect."""
        values = self.effect.values(self.theta, self.shape, robot)
        return dict(zip(self.effect.parameters, map(float, values), strict=True))

    def to_record(self) -> dict:
        """The term as plain values; joints from 1."""
        known = {} if self.nominal is None else {"nominal": self.nominal._values()}
        joints = [j + 1 for j in self.joints]
        return {"name": self.effect.name, "joints": joints, **self._values(), **known}

    def _values(self) -> dict:
        return {
            "shape": [float(x) for x in self.shape],
            "theta": self.theta.tolist(),
        }

    @classmethod
    def from_record(cls, record: Mapping) -> "Term":
        """The way back."""
        known = registry() | TABLES
        effect = known[check_name(record["name"], known, "effect")]
        joints = tuple(j - 1 for j in record["joints"])
        nominal = record.get("nominal")

        def read(values: Mapping, before: Term | None = None) -> Term:
            shape, theta = tuple(values["shape"]), np.array(values["theta"])
            return cls(effect, joints, shape, theta, before)

        return read(record, None if nominal is None else read(nominal))


def with_slots(terms: Iterable[Term], start: int) -> Iterator[tuple[Term, slice]]:
    """Terms with where their coefficients stand, behind ``start`` inertial ones."""
    for term in terms:
        stop = start + len(term.theta)
        yield term, slice(start, stop)
        start = stop
