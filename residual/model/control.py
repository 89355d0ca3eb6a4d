"""Torque that a controller asks for by a model: feed-forward and computed torque.

tau = M(q) a + C(q, qd) qd + g(q) + F(qd*) + whatever else the model has, eq. 31 of
G2017, with a = qdd* of the reference as feed-forward, and a = a_q of the feedback as
computed torque (eq. 8 and 9). Friction and every effect beside the body are taken along
the reference, which cannot chatter: dry friction turns as fast as the controller can
tell a joint from a standing one, and as the drive may follow.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.ndimage import uniform_filter1d

from residual.effects.base import State, Trait
from residual.model.corrected import CorrectedModel
from residual.model.model import Model
from residual.recording import Array
from residual.robot.dynamics import inverse_dynamics, with_inertial_parameters
from residual.robot.robot import Robot
from residual.signals.standstill import Standstill

_TURN = Standstill("smooth", 1.0)

Law = Callable[[int, Array, Array, Array], Array]


# Samples in which a joint that is not standing has gone a step of its encoder; about
# the time in which a loop of that rate answers. 20 instead of 50 leave a quarter to two
# thirds more of the tracking error; 100, a twentieth less.
SAMPLES = 50.0


@dataclass(frozen=True, slots=True)
class Turning:
    """How dry friction turns where the reference reverses; measured defaults."""

    encoder_step: float = 1e-4  # of every joint [rad]
    # Time in which a drive may go from nothing to the torque limit of its joint [s],
    # which states the torque rate; 0 for none. A tenth of a second costs no tracking;
    # the largest step at a reversal is a fifth of that without it.
    rise: float = 0.1

    def width(self, rate: float) -> float:
        """Return the speed over which friction turns [rad/s].

        Args:
            rate: Of the controller [Hz].
        """
        return self.encoder_step * rate / SAMPLES

    def torque_rate(self, robot: Robot) -> Array:
        """Return by how much torque may change at a reversal [N m/s]. Shape (dof,)."""
        if not self.rise:
            return np.full(robot.dof, np.inf)
        return robot.torque_limit / self.rise


AS_MEASURED = Turning()


def feed_forward(
    model: Model | CorrectedModel,
    t: Array,
    motion: Sequence[Array],
    turning: Turning = AS_MEASURED,
) -> Array:
    """Return the torque of a model for a reference [N m]. Shape (n, dof).

    Args:
        t: Times, evenly spaced [s]. Shape (n,).
        motion: q, qd and qdd of the reference. Shapes (n, dof).
        turning: How friction turns at reversals.
    """
    rate = (len(t) - 1) / np.ptp(t)
    prepared = _used(model, turning.width(rate))
    base: Model = getattr(prepared, "model", prepared)
    # Of a log the session's clock is known, of a motion to come it is not.
    since = t - t[0] if base.clock is None else t
    state = base.state(rate, since, motion)
    most = turning.torque_rate(base.robot) / rate
    # Friction turns at the torque rate at most. A reversal is known beforehand, so the
    # ramp lies around it, half before.
    ends = [base.torque_of_state(_turned(base, state, d)) for d in (1.0, -1.0)]
    swing = np.abs(ends[0] - ends[1]).max(axis=0)
    state = _turned(base, state, _ramp(state.sign, swing / most))
    torque = base.torque_of_state(state)
    if prepared is base:
        return torque
    # Tables step from level to level, at reversals and elsewhere.
    step = prepared.torque_of_state(state) - torque
    return torque + _ramp(step, np.ptp(step, axis=0) / most)


def _ramp(steps: Array, samples: Array) -> Array:
    """Steps as ramps of so many samples, half of each before it. Shape (n, dof)."""
    out = steps.copy()
    for j in np.flatnonzero(samples > 1):
        # An odd number, so that it lies in the middle.
        size = 2 * int(np.ceil((samples[j] - 1) / 2)) + 1
        out[:, j] = uniform_filter1d(out[:, j], size, mode="nearest")
    return out


def _turned(base: Model, state: State, sign: Array | float) -> State:
    """The same motion with another direction of friction."""
    state = replace(state, sign=np.broadcast_to(sign, state.q.shape))
    return replace(state, tau_model=base.torque_seen(state, as_reported=False))


def computed_torque(
    model: Model | CorrectedModel,
    t: Array,
    motion: Sequence[Array],
    turning: Turning = AS_MEASURED,
) -> Law:
    """Return the law of computed torque, with the mass matrix of that model.

    Args:
        t: Times of the reference, evenly spaced [s]. Shape (n,).
        motion: q, qd and qdd of the reference. Shapes (n, dof).
        turning: How friction turns at reversals.

    Returns:
        From step, position, speed and wanted acceleration to torque [N m]. (dof,).
    """
    prepared = _used(model, 1.0)
    base: Model = getattr(prepared, "model", prepared)
    rotor = base.drive()[1]
    body = with_inertial_parameters(base.robot.model, base.loaded())
    data, along = body.createData(), feed_forward(model, t, motion, turning)
    q, qd, qdd = motion
    beside = along - inverse_dynamics(body, q, qd, qdd) - rotor * qdd

    def law(k: int, angle: Array, speed: Array, demand: Array) -> Array:
        return pin.rnea(body, data, angle, speed, demand) + rotor * demand + beside[k]

    return law


def _used(model: Model | CorrectedModel, width: float) -> Model | CorrectedModel:
    """The model as a controller has it: friction turns over a width, logs are not late.

    Args:
        width: Speed over which friction turns [rad/s].
    """
    base = getattr(model, "model", model)
    dof = base.robot.dof
    late_report = Trait.REPORT | Trait.MEMORY
    late = [t for t in base.terms if late_report in t.effect.traits]
    base = replace(
        base,
        terms=tuple(t for t in base.terms if t not in late),
        standstill=(_TURN,) * dof,
        speed_floor=np.full(dof, width),
    )
    return replace(model, model=base) if isinstance(model, CorrectedModel) else base
