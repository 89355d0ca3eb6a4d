"""Torque that a controller asks for by a model: feed-forward and computed torque.

tau = M(q) a + C(q, qd) qd + g(q) + F(qd*) + whatever else the model has, eq. 31 of
G2017, with a = qdd* of the reference as feed-forward, and a = a_q of the feedback as
computed torque (eq. 8 and 9). Friction and every effect beside the body are taken along
the reference: by the speed that is read, friction would chatter where a joint stands.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from residual.model.corrected import Corrected
from residual.model.model import Model
from residual.recording import Array
from residual.robot.dynamics import inverse_dynamics, with_inertial_parameters
from residual.signals.direction import Standstill

WIDTH = 0.02  # rad/s: over which friction turns; less would chatter
_TURN = Standstill("smooth", 1.0)

Law = Callable[[int, Array, Array, Array], Array]


@dataclass(frozen=True, slots=True)
class Use:
    """What of a model drives the arm.

    Attributes:
        effects: Friction, tables and named effects; without them the rigid body and
            the rotors alone.
        acceleration: Torque for the acceleration of the reference.
    """

    effects: bool = True
    acceleration: bool = True


def feed_forward(
    model: Model | Corrected, t: Array, motion: Sequence[Array], use: Use
) -> Array:
    """Return the torque of a model for a reference [N m]. Shape (n, dof).

    Args:
        t: Times, evenly spaced [s]. Shape (n,).
        motion: q, qd and qdd of the reference. Shapes (n, dof).
    """
    q, qd, qdd = motion
    if not use.acceleration:
        qdd = np.zeros_like(qdd)
    made = _used(model, use.effects)
    own = getattr(made, "model", made)
    # Of a log the session's clock is known, of a motion to come it is not.
    since = t - t[0] if own.clock is None else t
    return made.along(since, (q, qd, qdd))


def computed_torque(
    model: Model | Corrected, t: Array, motion: Sequence[Array], use: Use
) -> Law:
    """Return the law of computed torque, with the mass matrix of that model.

    Args:
        t: Times of the reference, evenly spaced [s]. Shape (n,).
        motion: q, qd and qdd of the reference. Shapes (n, dof).

    Returns:
        From step, position, speed and wanted acceleration to torque [N m]. (dof,).
    """
    made = _used(model, use.effects)
    own: Model = getattr(made, "model", made)
    rotor = own.drive()[1]
    body = with_inertial_parameters(own.robot.model, own.loaded())
    data, along = body.createData(), feed_forward(model, t, motion, use)
    q, qd, qdd = motion
    wanted = qdd if use.acceleration else np.zeros_like(qdd)
    beside = along - inverse_dynamics(body, q, qd, wanted) - rotor * wanted
    planned = np.zeros_like(qdd) if use.acceleration else qdd

    def law(k: int, angle: Array, speed: Array, demand: Array) -> Array:
        # Without the acceleration of the reference only the feedback is left of it.
        push = demand - planned[k]
        return pin.rnea(body, data, angle, speed, push) + rotor * push + beside[k]

    return law


def _used(model: Model | Corrected, effects: bool) -> Model | Corrected:
    """The model as a controller has it: friction turns smoothly, logs are not late."""
    own = getattr(model, "model", model)
    dof = own.robot.dof
    late = [t for t in own.terms if t.effect.of_report and t.effect.remembers]
    terms = tuple(t for t in own.terms if t not in late)
    own = replace(
        own,
        terms=terms if effects else tuple(t for t in terms if _is_inertia(t)),
        tables=own.tables if effects else (),
        standstill=(_TURN,) * dof,
        speed_floor=np.full(dof, WIDTH),
    )
    if effects and isinstance(model, Corrected):
        return replace(model, model=own)
    return own


def _is_inertia(term) -> bool:
    return term.effect.carries == "acceleration"
