"""The one model type: nominal, identified and augmented are three values of it."""

from dataclasses import dataclass, field, replace

import numpy as np

from residual.effects.base import Effect, Joints, Shape, State
from residual.recording import Array, Recording
from residual.robot import dynamics
from residual.robot.robot import Robot
from residual.signals.direction import SMOOTH, Standstill, directions
from residual.signals.track import Filters, Track, at_samples, prepare


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


@dataclass(frozen=True, eq=False, slots=True)
class Model:
    """Rigid body plus effects.

    Attributes:
        robot: The arm.
        inertial: Inertial parameters, Pinocchio's order [SI]. Shape (10 dof,).
        terms: Effects with their coefficients.
        speed_floor: Speed under which a joint counts as standing [rad/s]. (dof,).
        standstill: Behaviour at standstill of each joint (see ``standstill``).
        clock: Start of the session on the logs' clock [s]; None where each log
            starts its own.
        filters: Signal path used to identify it.
    """

    robot: Robot
    inertial: Array
    terms: tuple[Term, ...] = ()
    speed_floor: Array | None = None
    standstill: tuple[Standstill, ...] = ()
    clock: float | None = None
    filters: Filters = field(default_factory=Filters)

    def predict(self, recording: Recording) -> Array:
        """Torque of the model on a recorded motion, at its own samples.

        Kinematics are zero-phase filtered; the torque itself is not filtered.

        Args:
            recording: A log of the same robot.

        Returns:
            Joint torque [N m]. Shape (n, dof).
        """
        (track,), _ = prepare([recording], self.filters, self.speed_floor, True)
        return at_samples(self.torque(self.observe(track)), track, recording)

    def observe(self, track: Track, regressor: Array | None = None) -> State:
        """What the effects see of one log, with this model's own torque."""
        if regressor is None:
            regressor = dynamics.regressor(
                self.robot.model, track.q, track.qd, track.qdd
            )
        shapes = self.standstill or (SMOOTH,) * self.robot.dof
        rigid = regressor @ self.inertial
        state = State(
            robot=self.robot,
            rate=track.rate,
            t=track.t - (track.t[0] if self.clock is None else self.clock),
            q=track.q,
            qd=track.qd,
            qdd=track.qdd,
            sign=directions(track.q, track.qd, self.speed_floor, shapes),
            regressor=regressor,
            rigid=rigid,
            tau_model=rigid,
            inertial=self._loaded(),
            drive=self._drive(),
        )
        return replace(state, tau_model=self.torque(state, as_reported=False))

    def torque(self, state: State, as_reported: bool = True) -> Array:
        """Torque at the samples of a state made by ``observe`` [N m]. (n, dof)."""
        rigid = state.regressor @ self.inertial if as_reported else state.rigid
        out = rigid.copy()
        for term in self.terms:
            if as_reported or not term.effect.of_report:
                out = out + term.torque(state)
        return out

    def _loaded(self) -> Array:
        """Inertial parameters with the loads that the terms add. Shape (10 dof,)."""
        out = self.inertial.copy()
        for term in self.terms:
            if term.effect.name == "payload":
                out[-len(term.theta) :] += term.theta
        return out

    def _drive(self) -> Array:
        """What the drives take per speed and per acceleration. Shape (2, dof)."""
        out = np.zeros((2, self.robot.dof))
        for row, name in enumerate(("viscous", "rotor_inertia")):
            for term in self.terms:
                if term.effect.name == name:
                    out[row, list(term.joints)] += term.theta
        return out

    def coefficients(self) -> Array:
        """All linear parameters: inertial, then each term's. Shape (p,)."""
        return np.concatenate([self.inertial, *(t.theta for t in self.terms)])

    def with_coefficients(self, values: Array) -> "Model":
        """The same structure with other linear parameters. Shape (p,)."""
        start = len(self.inertial)
        terms = []
        for term in self.terms:
            stop = start + len(term.theta)
            terms.append(replace(term, theta=values[start:stop]))
            start = stop
        size = len(self.inertial)
        return replace(self, inertial=values[:size], terms=tuple(terms))
