"""Named effects as other authors write them, in forms that the diagnosis lacks."""

import numpy as np
from numba import njit

from residual.recording import Array
from sim.effects.base import Effect, Values
from sim.engine import friction_laws
from tests.synthetic.laws import SyntheticMotion

_MICRO = 0.1  # damping of the bristles, as a share of the level per (rad/s)
_HARDENING = 0.3  # 1/rad^2


def lorentzian(state: SyntheticMotion, p: Values) -> Array:
    """Return level z / (1 + (qd / velocity)^2), not an exponential (Hess 1990)."""
    fade = friction_laws.stribeck_factor(state.qd, p["velocity"])
    return p["level"] * state.bristle * fade


def lugre(state: SyntheticMotion, p: Values) -> Array:
    """Return a LuGre contact (Canudas de Wit 1995) whose level fades with speed.

    dz/dt = qd - |qd| z / (d g), torque = level z / d + damping dz/dt, with
    g = exp(-(qd / velocity)^2) and bristles of the displacement d.
    """
    g = np.exp(-((state.qd / p["velocity"]) ** 2)) + 1e-3
    q, g = np.ascontiguousarray(state.q), np.ascontiguousarray(g)
    z = _lugre(q, g, float(p["displacement"]))
    rate = np.gradient(z, state.t, axis=0)
    return p["level"] * (z + _MICRO * p["displacement"] * rate)


def hyperbolic_warmup(state: SyntheticMotion, p: Values) -> Array:
    """Return level z / (1 + t / time_constant): slower than any exponential."""
    fade = 1.0 / (1.0 + state.t / p["time_constant"])
    return p["level"] * fade[:, None] * state.bristle


def two_time_warmup(state: SyntheticMotion, p: Values) -> Array:
    """Return level z by half a fast exponential and half one four times as slow."""
    fast = np.exp(-state.t / p["time_constant"])
    slow = np.exp(-state.t / (4.0 * p["time_constant"]))
    return 0.5 * p["level"] * (fast + slow)[:, None] * state.bristle


def leaning(load: Array, rate: float, p: Values) -> Array:
    """Return half_gap tanh(50 load / its rms): no flight across the play, no stop."""
    usual = np.sqrt(np.mean(load**2)) + 1e-9
    return p["half_gap"] * np.tanh(load / (0.02 * usual))


def cubic_cable(state: SyntheticMotion, p: Values) -> Array:
    """Return stiffness (x + 0.3 x^3), x = q - rest: a bundle of hoses that hardens."""
    x = state.q - p["rest"]
    return p["stiffness"] * (x + _HARDENING * x**3)


def one_way_viscous(state: SyntheticMotion, p: Values) -> Array:
    """Return 2 coefficient qd forwards and nothing backwards, blended by z."""
    return p["coefficient"] * state.qd * (1.0 + state.bristle)


def soft_limit(tau: Array, level: float) -> Array:
    """Return level tanh(tau / level): an amplifier that gives in gently [N m]."""
    return level * np.tanh(tau / level)


@njit(cache=True)
def _lugre(q, g, displacement):
    """Bristle state over its displacement; exact where g is constant in a step."""
    n, k = q.shape
    z = np.zeros((n, k))
    for i in range(1, n):
        for j in range(k):
            step = q[i, j] - q[i - 1, j]
            end = g[i, j] if step >= 0 else -g[i, j]
            rest = np.exp(-abs(step) / (displacement * g[i, j]))
            z[i, j] = end + (z[i - 1, j] - end) * rest
    return z


LAWS = {
    "lorentzian": lorentzian,
    "lugre": lugre,
    "hyperbolic_warmup": hyperbolic_warmup,
    "two_time_warmup": two_time_warmup,
    "cubic_cable": cubic_cable,
    "one_way_viscous": one_way_viscous,
}
LEADS = {"leaning_play": leaning}
LEVEL, VELOCITY, TIME = {"level": "N m"}, {"velocity": "rad/s"}, {"time_constant": "s"}
EFFECTS = {
    effect.name: effect
    for effect in (
        Effect("lorentzian", LEVEL | VELOCITY),
        Effect("lugre", LEVEL | VELOCITY | {"displacement": "rad"}),
        Effect("hyperbolic_warmup", LEVEL | TIME),
        Effect("two_time_warmup", LEVEL | TIME),
        Effect("leaning_play", {"half_gap": "rad"}),
        Effect("soft_limit", LEVEL, report=lambda tau, t, onset, p: soft_limit(tau, p["level"])),
        Effect("cubic_cable", {"stiffness": "N m/rad", "rest": "rad"}),
        Effect("one_way_viscous", {"coefficient": "N m s/rad"}),
    )
}

# Effects of the vocabulary that each may be taken for.
FORMS = {
    "lorentzian": ("stribeck",),
    "lugre": ("stribeck", "presliding"),
    "hyperbolic_warmup": ("warmup",),
    "two_time_warmup": ("warmup",),
    "leaning_play": ("backlash",),
    "soft_limit": ("saturation",),
    "cubic_cable": ("spring",),
    "one_way_viscous": ("viscous_asymmetry",),
}
