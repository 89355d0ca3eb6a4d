"""How the torque of all joints changes when one joint is not where it seems to be.

Encoders that lie, gears that twist and play in them move a joint by a shift that may
itself change with time:

    d tau = dtau/dq_j shift + dtau/dqd_j shift' + dtau/dqdd_j shift''

The derivatives are those of the recursive Newton-Euler algorithm (Carpentier and
Mansard 2018, as Pinocchio has them), once per log.
"""

from collections import OrderedDict

import numpy as np
import pinocchio as pin

from residual.effects.base import State
from residual.recording import Array
from residual.robot.dynamics import with_inertial_parameters
from residual.signals.low_pass import low_pass

# A shift made of the model's torque holds qdd, and its own second derivative the fourth
# of a noisy angle: only what is slow is told apart from noise.
SLOW = 5.0  # Hz

KEPT = 140_000  # rows whose derivatives are remembered: they are looked at many times

_Known = OrderedDict[tuple, tuple[tuple, Array]]
_KNOWN: _Known = OrderedDict()


def sensitivity(state: State) -> Array:
    """Derivatives of the rigid torque to q, qd and qdd. Shape (3, n, dof, dof).

    The last axis is the joint that moves, the one before it the row of torque.
    """
    own = b"" if state.inertial is None else state.inertial.tobytes()
    # They are kept with the result, so that nothing else can get these ids.
    known = state.robot, state.q, state.qd, state.qdd
    key = (*map(id, known), own)
    if key not in _KNOWN:
        _KNOWN[key] = known, _derivatives(state)
    _KNOWN.move_to_end(key)
    while len(_KNOWN) > 1 and sum(d.shape[1] for _, d in _KNOWN.values()) > KEPT:
        _KNOWN.popitem(last=False)
    return _KNOWN[key][1]


def _derivatives(state: State) -> Array:
    model = model_of(state)
    data = model.createData()
    q, qd, qdd = map(np.ascontiguousarray, (state.q, state.qd, state.qdd))
    out = np.empty((3, len(q), model.nv, model.nv))
    for i in range(len(q)):
        out[:, i] = pin.computeRNEADerivatives(model, data, q[i], qd[i], qdd[i])
    return out


def model_of(state: State) -> pin.Model:
    """The rigid body of the current model, loads included."""
    if state.inertial is None:
        return state.robot.model
    return with_inertial_parameters(state.robot.model, state.inertial)


def moved(state: State, joint: int, shift: Array, rates: tuple[Array, Array]) -> Array:
    """Change of all torques when joint j (from 0) is shifted [rad]. Shape (n, dof).

    Rates are the first and second derivative of the shift [rad/s, rad/s^2].
    """
    parts = zip(sensitivity(state), (shift, *rates), strict=True)
    return sum(slope[:, :, joint] * x[:, None] for slope, x in parts)


def turned(state: State, joint: int, shift: Array, rates: tuple[Array, Array]) -> Array:
    """The same where the drive is shifted with the joint. Shape (n, dof)."""
    out = moved(state, joint, shift, rates)
    if state.drive is not None:
        viscous, rotor = state.drive[:, joint]
        out[:, joint] += viscous * rates[0] + rotor * rates[1]
    return out


def slow(state: State, values: Array) -> Array:
    """What of a signal is slow enough to be differentiated twice. Shape (n,)."""
    return low_pass(values, min(SLOW, 0.05 * state.rate), state.rate)


def rates(state: State, values: Array) -> tuple[Array, Array]:
    """First and second time derivative of a signal. Shapes (n,)."""
    first = np.gradient(values, 1 / state.rate)
    return first, np.gradient(first, 1 / state.rate)
