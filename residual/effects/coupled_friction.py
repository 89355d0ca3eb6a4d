"""Friction and rotor inertia of a gear that two wrist joints share.

A wrist whose motors drive through one another turns a gear with qd_i + qd_j or
qd_i - qd_j; its friction and its inertia load both joints.
"""

import numpy as np

from residual.effects.base import Effect


def _columns(state, joints, shape):
    a, b = joints
    (sign,) = shape
    speed = state.qd[:, a] + sign * state.qd[:, b]
    acceleration = state.qdd[:, a] + sign * state.qdd[:, b]
    # Smooth within a twentieth of the usual speed: the shared gear has no encoder,
    # so its own standstill cannot be masked as that of a joint is.
    scale = 0.05 * np.quantile(np.abs(speed), 0.95) + 1e-9
    drag = np.stack([np.tanh(speed / scale), speed, acceleration], axis=1)
    return np.stack([drag, sign * drag], axis=1)


EFFECT = Effect(
    name="coupled_friction",
    sentence="friction and inertia of a gear that turns with both joints' motion",
    parameters={
        "level": "N m",
        "coefficient": "N m s/rad",
        "inertia": "kg m^2",
        "sign": "-",
    },
    columns=_columns,
    scope="pair",
    values=lambda theta, shape, robot: np.array([*theta, shape[0]]),
    from_values=lambda values: (values[:3], tuple(values[3:])),
    shapes=lambda span, j: ((1.0,), (-1.0,)),
)
