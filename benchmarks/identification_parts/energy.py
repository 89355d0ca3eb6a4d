"""The books of power: what torque gives must be what the body gains.

tau' qd = d/dt (T(q, qd) + V(q))    (rigid body, no friction)

The energies are Pinocchio's own, differentiated numerically along the motion. Nothing
here knows a regressor or an inverse dynamics, so it can judge both.
"""

import numpy as np
import pinocchio as pin

Array = np.ndarray

_STEP = 2e-4  # s; with the six points used the error falls as its sixth power
_POINTS = (1, 2, 3)
_WEIGHTS = (45 / 60, -9 / 60, 1 / 60)


def energy(model: pin.Model, q: Array, qd: Array) -> Array:
    """Return kinetic plus potential energy [J]. Shape (n,) from (n, dof)."""
    data, out = model.createData(), np.empty(len(q))
    for i in range(len(q)):
        out[i] = pin.computeKineticEnergy(model, data, q[i], qd[i])
        out[i] += pin.computePotentialEnergy(model, data, q[i])
    return out


def power(model: pin.Model, q: Array, qd: Array, qdd: Array) -> Array:
    """Return the rate of energy of states that go on at constant acceleration.

    dE/dt by central differences over three points on either side, of sixth order.

    Args:
        q: Positions [rad]. Shape (n, dof).
        qd: Velocities [rad/s]. Shape (n, dof).
        qdd: Accelerations [rad/s^2]. Shape (n, dof).

    Returns:
        Power [W]. Shape (n,).
    """
    rate = np.zeros(len(q))
    for k, weight in zip(_POINTS, _WEIGHTS, strict=True):
        for side in (-1, 1):
            t = side * k * _STEP
            place, speed = q + t * qd + t**2 / 2 * qdd, qd + t * qdd
            rate += side * weight * energy(model, place, speed)
    return rate / _STEP


def power_miss(
    model: pin.Model, motion: tuple[Array, Array, Array], tau: Array
) -> float:
    """Return how far the power of a torque is from the rate of energy, relative.

    |tau' qd - dE/dt| / |tau' qd| over all states.

    Args:
        motion: q, qd, qdd. Shape (n, dof) each.
        tau: Torque that some other code found [N m]. Shape (n, dof).
    """
    given = np.sum(tau * motion[1], axis=1)
    gained = power(model, *motion)
    return float(np.linalg.norm(given - gained) / np.linalg.norm(given))
