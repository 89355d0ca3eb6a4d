"""The same physics in other words: laws that no textbook of the diagnosis has.

Each is one of the named effects as another author writes it down. Whoever names the
effect behind it is right, whatever the exact form.
"""

from collections.abc import Mapping

import numpy as np
from numba import njit

from sim import laws
from sim.synthetic.state import State

Array = np.ndarray

_MICRO = 0.1  # damping of the bristles, as a share of the level per (rad/s)
_HARDENING = 0.3  # 1/rad^2


def lorentzian(state: State, p: Mapping) -> Array:
    """Return level z / (1 + (qd / velocity)^2): Stribeck's curve after Hess (1990)."""
    return p["level"] * state.bristle * laws.stribeck(state.qd, p["velocity"])


def lugre(state: State, p: Mapping) -> Array:
    """Return a LuGre contact (Canudas de Wit 1995) whose level fades with speed.

    dz/dt = qd - |qd| z / (d g), torque = level z / d + damping dz/dt, with
    g = exp(-(qd / velocity)^2) and bristles of the displacement d.
    """
    g = np.exp(-((state.qd / p["velocity"]) ** 2)) + 1e-3
    z = _lugre(
        np.ascontiguousarray(state.q),
        np.ascontiguousarray(g),
        float(p["displacement"]),
    )
    rate = np.gradient(z, state.t, axis=0)
    return p["level"] * (z + _MICRO * p["displacement"] * rate)


def hyperbolic_warmup(state: State, p: Mapping) -> Array:
    """Return level z / (1 + t / time_constant): slower than any exponential."""
    fade = 1.0 / (1.0 + state.t / p["time_constant"])
    return p["level"] * fade[:, None] * state.bristle


def cubic_cable(state: State, p: Mapping) -> Array:
    """Return stiffness (x + 0.3 x^3), x = q - rest: a bundle of hoses that hardens."""
    x = state.q - p["rest"]
    return p["stiffness"] * (x + _HARDENING * x**3)


def one_way_viscous(state: State, p: Mapping) -> Array:
    """Return 2 coefficient qd forwards and nothing backwards, blended by z.

    Half of it is viscous friction in both directions, half its asymmetry.
    """
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
