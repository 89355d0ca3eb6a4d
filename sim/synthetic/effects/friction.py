"""Losses. z is the bristle state of the joint: sign of the motion, with memory."""

from collections.abc import Mapping

import numpy as np

from sim.synthetic.bristle import deflection
from sim.synthetic.state import State

Array = np.ndarray


def viscous(state: State, p: Mapping) -> Array:
    """Return coefficient qd."""
    return p["coefficient"] * state.qd


def coulomb(state: State, p: Mapping) -> Array:
    """Return level z."""
    return p["level"] * state.bristle


def coulomb_asymmetry(state: State, p: Mapping) -> Array:
    """Return level max(z, 0) - level min(z, 0): more friction in one direction."""
    forward, backward = np.maximum(state.bristle, 0), np.minimum(state.bristle, 0)
    return p["level"] * forward - p["level"] * backward


def viscous_asymmetry(state: State, p: Mapping) -> Array:
    """Return +coefficient qd forwards and -coefficient qd backwards, blended by z."""
    return p["coefficient"] * state.qd * state.bristle


def quadratic_viscous(state: State, p: Mapping) -> Array:
    """Return coefficient qd sqrt(qd^2 + 0.02^2): churning, linear when very slow."""
    return p["coefficient"] * state.qd * np.hypot(state.qd, 0.02)


def power_viscous(state: State, p: Mapping) -> Array:
    """Return coefficient qd (qd^2 + 0.01^2)^((exponent - 1) / 2): shear thinning."""
    speed = np.hypot(state.qd, 0.01)
    return p["coefficient"] * state.qd * speed ** (p["exponent"] - 1.0)


def stribeck(state: State, p: Mapping) -> Array:
    """Return level z / (1 + (qd / velocity)^2): a Lorentzian, not an exponential."""
    return p["level"] * state.bristle / (1.0 + (state.qd / p["velocity"]) ** 2)


def load_friction(state: State, p: Mapping) -> Array:
    """Return coefficient sqrt(load^2 + e^2) z with e a tenth of the Coulomb level."""
    return p["coefficient"] * np.hypot(state.load, 0.1 * state.coulomb) * state.bristle


def position_friction(state: State, p: Mapping) -> Array:
    """Return z a (cos x + 0.1 cos 2x), x = q - atan2(sin, cos), a = |(cos, sin)|.

    With the base friction: Fc (1 + (a / Fc) cos x + ...), an eccentric gear wheel.
    """
    size, phase = np.hypot(p["cos"], p["sin"]), np.arctan2(p["sin"], p["cos"])
    x = state.q - phase
    return size * (np.cos(x) + 0.1 * np.cos(2 * x)) * state.bristle


def coupled_friction(state: State, p: Mapping) -> Array:
    """Return the friction of a gear that turns with u = q_i + sign q_j, on both joints.

    f = level z(u) + coefficient u'; torque (f, sign f), z a bristle driven by u.
    """
    sign = p["sign"]
    u = state.q[:, 0] + sign * state.q[:, 1]
    z = deflection(u[:, None], state.displacement[:1])[:, 0]
    f = p["level"] * z + p["coefficient"] * (state.qd[:, 0] + sign * state.qd[:, 1])
    return np.column_stack([f, sign * f])


def warmup(state: State, p: Mapping) -> Array:
    """Return level z (0.75 exp(-t/T) + 0.25 exp(-t/(3T))): oil, then the housing."""
    oil = np.exp(-state.t / p["time_constant"])
    fade = 0.75 * oil + 0.25 * oil ** (1 / 3)
    return p["level"] * fade[:, None] * state.bristle
