"""Change of all joint torques when one joint is shifted from its measured angle.

Encoder errors, elastic gears and backlash move a joint by a shift x(t):

    d tau = dtau/dq_j x + dtau/dqd_j x' + dtau/dqdd_j x''

The derivatives are those of the recursive Newton-Euler algorithm (Carpentier and
Mansard 2018, as Pinocchio has them), computed once per log.
"""

from threading import Lock

import numpy as np
import pinocchio as pin
from cachetools import LRUCache, cached

from residual.effects.base import State
from residual.recording import Array
from residual.robot.dynamics import (
    PER_LINK,
    build_motion_key,
    compute_weight_torques,
    replace_inertial_parameters,
)
from residual.signals.filters import filter_low_pass

# A shift from the model's torque contains qdd, and its second derivative the fourth
# derivative of a noisy angle: only the slow part exceeds the noise.
SLOW = 5.0  # Hz

KEPT = 1 << 27  # bytes of cached derivatives, which are read many times


def _key(state: State) -> tuple:
    own = b"" if state.inertial is None else state.inertial.tobytes()
    return *build_motion_key(state.robot, state.q, state.qd, state.qdd), own


@cached(LRUCache(KEPT, getsizeof=lambda slopes: slopes.nbytes), key=_key, lock=Lock())
def compute_torque_derivatives(state: State) -> Array:
    """Derivatives of the rigid torque to q, qd and qdd. Shape (3, n, dof, dof).

    The last axis is the joint that moves, the one before it the row of torque.
    """
    mass = np.array([]) if state.inertial is None else state.inertial[::PER_LINK]
    if (np.cumsum(mass[::-1]) > 0).all():
        return _differentiate(state, build_loaded_model(state))
    # Pinocchio sums bodies of positive mass only, unlike a removed load. Torque is linear
    # in the parameters: a mass is added to every body and subtracted again.
    ballast = np.zeros_like(state.inertial)
    ballast[::PER_LINK] = 1.0 - mass.min()
    pair = (
        replace_inertial_parameters(state.robot.model, parameters)
        for parameters in (state.inertial + ballast, ballast)
    )
    heavy, light = (_differentiate(state, model) for model in pair)
    return heavy - light


def _differentiate(state: State, model: pin.Model) -> Array:
    data = model.createData()
    q, qd, qdd = map(np.ascontiguousarray, (state.q, state.qd, state.qdd))
    out = np.empty((3, len(q), model.nv, model.nv))
    for i in range(len(q)):
        out[:, i] = pin.computeRNEADerivatives(model, data, q[i], qd[i], qdd[i])
    return out


@cached(LRUCache(KEPT, getsizeof=lambda torque: torque.nbytes), key=_key, lock=Lock())
def compute_weight_torque(state: State) -> Array:
    """Torques of gravity of 1 m/s^2 along x and y of the base. Shape (n, dof, 2)."""
    return compute_weight_torques(build_loaded_model(state), state.q)[:, :, :2]


def build_loaded_model(state: State) -> pin.Model:
    """The rigid body of the current model, loads included."""
    if state.inertial is None:
        return state.robot.model
    return replace_inertial_parameters(state.robot.model, state.inertial)


def compute_shift_torque(
    state: State, joint: int, shift: Array, rates: tuple[Array, Array]
) -> Array:
    """Change of all torques when joint j (from 0) is shifted [rad]. Shape (n, dof).

    Rates are the first and second derivative of the shift [rad/s, rad/s^2].
    """
    parts = zip(compute_torque_derivatives(state), (shift, *rates), strict=True)
    return sum(slope[:, :, joint] * x[:, None] for slope, x in parts)


def filter_before_differentiation(state: State, values: Array) -> Array:
    """Low-pass a signal for two differentiations. Shape (n,)."""
    return filter_low_pass(values, min(SLOW, 0.05 * state.rate), state.rate)


def compute_time_derivatives(state: State, values: Array) -> tuple[Array, Array]:
    """First and second time derivative of a signal. Shapes (n,)."""
    first = np.gradient(values, 1 / state.rate)
    return first, np.gradient(first, 1 / state.rate)
