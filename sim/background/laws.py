"""Laws of the background; the plant in the physics engine compiles them.

Plain functions of arrays or numbers.
"""

import numpy as np

Value = np.ndarray | float

_PRELOAD = 0.05  # of the usual torque: gears are never without load


def fading(qd: Value, velocity: Value) -> Value:
    """Return 1 / (1 + x + x^2), x = |qd| / velocity: a cusp at rest, a long tail."""
    x = np.abs(qd) / velocity
    return 1.0 / (1.0 + x + x * x)


def pressed(load: Value, span: Value) -> Value:
    """Return span (x^2 + 0.05^2)^(1/3), x = load / span, as round teeth press [N m].

    Hertz: the area of contact, and with it friction, grows as the load to two thirds.
    """
    x = load / span
    return span * (x * x + _PRELOAD * _PRELOAD) ** (1.0 / 3.0)


def leaning(direction: Value, lean: Value) -> Value:
    """Return 1 + lean in one direction and 1 - lean in the other."""
    return 1.0 + lean * direction


def warmth(oil: Value, housing: Value) -> Value:
    """Return the warmth of the contact between oil and housing, 1 in the end."""
    return 0.4 * oil + 0.6 * housing


def thinned(warm: Value, growth: Value) -> Value:
    """Return 1 / (1 + growth warm): grease thins, at first quickly."""
    return 1.0 / (1.0 + growth * warm)


def heated(warm: Value, power: Value, time_constant: Value, dt: float) -> Value:
    """Return a warmth after a step, for a power in units of the usual one."""
    return warm + dt / time_constant * (power - warm)


def twisted(load: Value, twist: Value, span: Value) -> Value:
    """Return twist x / sqrt(1 + x^2 / 2), x = load / span: it hardens [rad]."""
    x = load / span
    return twist * x / np.sqrt(1.0 + x * x / 2.0)
