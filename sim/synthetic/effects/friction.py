"""Losses. z is the bristle state of the joint: sign of the motion, with memory."""

from collections.abc import Mapping

import numpy as np

from sim import laws
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
    """Return coefficient qd times the viscosity of churning oil."""
    return p["coefficient"] * state.qd * laws.quadratic_viscosity(state.qd)


def power_viscous(state: State, p: Mapping) -> Array:
    """Return coefficient qd times the viscosity of grease that shears."""
    thin = laws.power_viscosity(state.qd, p["exponent"])
    return p["coefficient"] * state.qd * thin


def stribeck(state: State, p: Mapping) -> Array:
    """Return level z / (1 + (qd / velocity)^2): a Lorentzian, not an exponential."""
    return p["level"] * state.bristle * laws.stribeck(state.qd, p["velocity"])


def load_friction(state: State, p: Mapping) -> Array:
    """Return coefficient sqrt(load^2 + e^2) z with e a tenth of the Coulomb level."""
    load = laws.carried(state.load, 0.1 * state.coulomb)
    return p["coefficient"] * load * state.bristle


def position_friction(state: State, p: Mapping) -> Array:
    """Return z a (cos x + 0.1 cos 2x), x = q - atan2(sin, cos), a = |(cos, sin)|.

    With the base friction: Fc (1 + (a / Fc) cos x + ...), an eccentric gear wheel.
    """
    size, phase = np.hypot(p["cos"], p["sin"]), np.arctan2(p["sin"], p["cos"])
    return size * laws.eccentric(state.q - phase) * state.bristle


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


def presliding(state: State, p: Mapping) -> Array:
    """Return level z of another contact, whose bristles yield further."""
    ways = np.full(state.q.shape[1], p["displacement"])
    return p["level"] * deflection(state.q, ways)
