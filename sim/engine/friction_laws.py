"""Laws of friction, springs and magnets that the simulated arms obey.

Plain functions of arrays; the closed-loop plant compiles them for single numbers. They
are deliberately not the formulas of the diagnosis.
"""

import numpy as np

Value = np.ndarray | float

# Codes of the laws in the compiled plant; the file of an effect states which it uses, and
# with which parameters.
# Rows of friction.
LEVEL, ASYMMETRY, VISCOUS, VISCOUS_ASYMMETRY, QUADRATIC, POWER = range(6)
STRIBECK, CARRIED, POSITION, WARMUP, BRISTLE = range(6, 11)
FADING, PRESSED = 11, 12  # of the background
# Rows of torque.
CONSTANT, HOSE, GAS_SPRING, RIPPLE, COGGING_SUM, WALL, SERIES, DEAD_ZONE = range(8)
WAVE = 8  # of the background
# These torques act on the motor side of an elastic transmission, the rest on the link.
AT_MOTOR = (RIPPLE, COGGING_SUM, DEAD_ZONE, WAVE)

_CHURN, _THIN, _TURN = 0.02, 0.01, 0.02  # rad/s
_PRELOAD = 0.05  # of the usual torque: gears are never without load


def smooth_absolute_speed(qd: Value) -> Value:
    """Return sqrt(qd^2 + 0.02^2): churning, linear when very slow [rad/s]."""
    return np.hypot(qd, _CHURN)


def shear_thinning_factor(qd: Value, exponent: float) -> Value:
    """Return (qd^2 + 0.01^2)^((exponent - 1) / 2): shear thinning."""
    return np.hypot(qd, _THIN) ** (exponent - 1.0)


def smooth_motion_direction(qd: Value) -> Value:
    """Return the direction of motion, blended within some 0.02 rad/s."""
    return qd / np.hypot(qd, _TURN)


def stribeck_factor(qd: Value, velocity: float, exponent: float = 2.0) -> Value:
    """Return 1 / (1 + |qd / velocity|^exponent): not an exponential (Hess 1990)."""
    return 1.0 / (1.0 + np.abs(qd / velocity) ** exponent)


def preloaded_torque(load: Value, preload: Value) -> Value:
    """Return sqrt(load^2 + floor^2): preload of the gear keeps it from zero [N m]."""
    return np.hypot(load, preload)


def eccentric_gear_wave(x: Value) -> Value:
    """Return cos x + 0.1 cos 2x: a gear wheel mounted off its centre."""
    return np.cos(x) + 0.1 * np.cos(2 * x)


def hose_deflection(x: Value) -> Value:
    """Return x / sqrt(1 + (x / 4)^2): a hose that softens [rad]."""
    return x / np.hypot(1.0, x / 4.0)


def gas_spring_torque(x: Value) -> Value:
    """Return the torque of a gas spring between two eyes, not normalized.

    The eyes sit at 1 and 1/4 of a length from the joint axis, so the cylinder is
    L(x) = sqrt(1 + 1/16 - cos(x) / 2) long; pulled out it presses its gas, whose force
    rises with (1 + 0.4 (L - 3/4))^1.2. Torque = force dL/dx.
    """
    length = np.sqrt(1.0 + 1 / 16 - np.cos(x) / 2)
    force = (1.0 + 0.4 * (length - 0.75)) ** 1.2
    return force * np.sin(x) / (4 * length)


def motor_cogging_wave(x: Value) -> Value:
    """Return cos x + 0.15 cos 2x: cogging of a motor."""
    return np.cos(x) + 0.15 * np.cos(2 * x)


def gas_spring_peak_torque() -> float:
    """Return the largest value of gas_spring over one turn."""
    return float(gas_spring_torque(np.linspace(0, 2 * np.pi, 721)).max())


# -- of the background: none is a law of `sim.effects` or of the diagnosis, so that no
# -- finding is due to both sides using the same curve.


def low_speed_friction_factor(qd: Value, velocity: Value) -> Value:
    """Return 1 / (1 + x + x^2), x = |qd| / velocity: a cusp at rest, a long tail."""
    x = np.abs(qd) / velocity
    return 1.0 / (1.0 + x + x * x)


def hertz_contact_torque(load: Value, span: Value) -> Value:
    """Return span (x^2 + 0.05^2)^(1/3), x = load / span, as round teeth press [N m].

    Hertz: the area of contact, and with it friction, grows as the load to two thirds.
    """
    x = load / span
    return span * (x * x + _PRELOAD * _PRELOAD) ** (1.0 / 3.0)


def directional_friction_factor(direction: Value, asymmetry: Value) -> Value:
    """Return 1 + lean in one direction and 1 - lean in the other."""
    return 1.0 + asymmetry * direction


def mix_contact_warmth(oil: Value, housing: Value) -> Value:
    """Return the warmth of the contact between oil and housing, 1 in the end."""
    return 0.4 * oil + 0.6 * housing


def grease_thinning_factor(warmth: Value, growth: Value) -> Value:
    """Return 1 / (1 + growth warm): grease thins, at first quickly."""
    return 1.0 / (1.0 + growth * warmth)


def step_warmth(warmth: Value, power: Value, time_constant: Value, dt: float) -> Value:
    """Return a warmth after a step, for a power in units of the typical one."""
    return warmth + dt / time_constant * (power - warmth)
