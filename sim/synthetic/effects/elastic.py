"""Inertia, springs, magnets and weights: torques without loss."""

from collections.abc import Mapping

import numpy as np

from sim.synthetic.state import State

Array = np.ndarray


def rotor_inertia(state: State, p: Mapping) -> Array:
    """Return d/dt dT/dqd = inertia qdd of the motor's T = 1/2 inertia qd^2."""
    return p["inertia"] * state.qdd


def offset(state: State, p: Mapping) -> Array:
    """Return a constant torque."""
    return p["torque"] * np.ones_like(state.q)


def spring(state: State, p: Mapping) -> Array:
    """Return stiffness x / sqrt(1 + (x/4)^2), x = q - rest: a hose that softens."""
    x = state.q - p["rest"]
    return p["stiffness"] * x / np.hypot(1.0, x / 4.0)


def balancer(state: State, p: Mapping) -> Array:
    """Return the torque of a gas spring between two eyes, of size |(cos, sin)|.

    The eyes sit at 1 and 1/4 of a length from the joint axis, so the cylinder is
    L(x) = sqrt(1 + 1/16 - cos(x) / 2) long; pulled out it presses its gas, whose force
    rises with (1 + 0.4 (L - 3/4))^1.2. Torque = force dL/dx, x = q - x0, scaled to
    unit peak; close to sin q sin-parameter + cos q cos-parameter.
    """
    size, zero = np.hypot(p["cos"], p["sin"]), np.arctan2(-p["cos"], p["sin"])
    circle = _gas_spring(np.linspace(0, 2 * np.pi, 721))
    return size * _gas_spring(state.q - zero) / circle.max()


def ripple(state: State, p: Mapping) -> Array:
    """Return a (cos x + 0.15 cos 2x), x = order q + phase: a magnet's cogging."""
    x = p["order"] * state.q + p["phase"]
    return p["amplitude"] * (np.cos(x) + 0.15 * np.cos(2 * x))


def _gas_spring(x: Array) -> Array:
    length = np.sqrt(1.0 + 1 / 16 - np.cos(x) / 2)
    force = (1.0 + 0.4 * (length - 0.75)) ** 1.2
    return force * np.sin(x) / (4 * length)
