"""Friction and rotor inertia of a gear that two wrist joints share.

A wrist whose motors drive through one another turns a gear with qd_i + qd_j or
qd_i - qd_j; its friction and its inertia load both joints.
"""

import numpy as np

from residual.effects.base import Effect, ExportedLaw


def _columns(state, joints, shape):
    a, b = joints
    sign, width = shape
    speed = state.qd[:, a] + sign * state.qd[:, b]
    acceleration = state.qdd[:, a] + sign * state.qdd[:, b]
    drag = np.stack([np.tanh(speed / width), speed, acceleration], axis=1)
    return np.stack([drag, sign * drag], axis=1)


def _shapes(span, j):
    """Both senses, smooth within a twentieth of the usual speed.

    The shared gear has no encoder, so its own standstill cannot be masked as that of a
    joint is.
    """
    width = 0.05 * max(float(span.speed[j]), 1e-3)
    return ((1.0, width), (-1.0, width))


def _possible(theta, shape, limits):
    """A gear takes power and has inertia; small values may drown in noise."""
    drag = theta[:2] * (1.0, limits.speed)
    return bool(drag.sum() > 0 and np.all(np.abs(drag) < limits.torque))


DRAG = (
    "a[0] * tanh((qd[0] + s[0] * qd[1]) / s[1])"
    " + a[1] * (qd[0] + s[0] * qd[1]) + a[2] * (qdd[0] + s[0] * qdd[1])"
)
WIDTH = 0.02  # rad/s, where values are declared without a log at hand

EFFECT = Effect(
    name="coupled_friction",
    noun="coupled friction",
    place="between {joints}",
    sentence="friction and inertia of a gear that turns with both joints' motion",
    equation=(
        "w = qd_i + sign * qd_j; tau_i = level * sgn(w) + coefficient * w + "
        "inertia * w'; tau_j = sign * tau_i"
    ),
    parameters={"level": "N m", "coefficient": "N m s/rad", "inertia": "kg m^2", "sign": "1"},
    columns=_columns,
    scope="pair",
    values=lambda theta, shape, robot: np.array([*theta, shape[0]]),
    from_values=lambda values, robot: (values[:3], (float(values[3]), WIDTH)),
    shapes=_shapes,
    possible=_possible,
    inexact=0.04,  # its curve is smooth at standstill, which reduces the level by 3.6 %
    portable=ExportedLaw((DRAG, f"s[0] * ({DRAG})")),
)
