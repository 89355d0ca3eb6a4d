"""What friction does while a joint stands: a choice per joint, made on fit logs.

At standstill Coulomb friction is set-valued. A log's torque then shows which value
the drive and the gear left behind: the sign of creep, the sign of the last motion
(a bristle that holds), or nothing on average. No fit uses such rows; predictions
need an answer all the same.
"""

import numba
import numpy as np

from residual.recording import Array

SMOOTH = "smooth"
SHAPES: tuple[str | float, ...] = (SMOOTH, "zero", 0.0, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)


def direction(q: Array, qd: Array, floor: float, shape: str | float) -> Array:
    """Direction of motion of one joint, with its behaviour at standstill.

    Args:
        q: Position [rad]. Shape (n,).
        qd: Velocity [rad/s]. Shape (n,).
        floor: Speed under which the joint counts as standing [rad/s].
        shape: "smooth" for tanh(4 qd / floor); "zero" for nothing under the floor;
            a number for a bristle of that displacement (Dahl 1968) [rad], where 0
            is the plain sign of velocity.

    Returns:
        Values in [-1, 1]. Shape (n,).
    """
    if shape == SMOOTH:
        return np.tanh(4 * qd / floor)
    if shape == "zero":
        return np.where(np.abs(qd) < floor, 0.0, np.sign(qd))
    if shape == 0.0:
        return np.sign(qd)
    return _bristle(np.ascontiguousarray(q), float(shape))


@numba.njit(cache=True)
def _bristle(q, displacement):
    """Dahl's state by its exact solution over each step of position, start at rest."""
    state = np.zeros(len(q))
    for i in range(1, len(q)):
        step = q[i] - q[i - 1]
        goal = 1.0 if step > 0 else -1.0
        fade = np.exp(-abs(step) / displacement)
        state[i] = goal + (state[i - 1] - goal) * fade
    return state


def directions(q: Array, qd: Array, floor: Array, shapes) -> Array:
    """Direction of motion of every joint. Shapes (n, dof), (dof,), one per joint."""
    pairs = zip(q.T, qd.T, floor, shapes, strict=True)
    return np.column_stack([direction(*p) for p in pairs])
