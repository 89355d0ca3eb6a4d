"""Inertia, springs, magnets and weights: torques without loss."""

from collections.abc import Mapping

import numpy as np

from sim import laws
from sim.synthetic.state import State

Array = np.ndarray


def rotor_inertia(state: State, p: Mapping) -> Array:
    """Return d/dt dT/dqd = inertia qdd of the motor's T = 1/2 inertia qd^2."""
    return p["inertia"] * state.qdd


def offset(state: State, p: Mapping) -> Array:
    """Return a constant torque."""
    return p["torque"] * np.ones_like(state.q)


def spring(state: State, p: Mapping) -> Array:
    """Return stiffness times q - rest: a hose that softens."""
    return p["stiffness"] * laws.hose(state.q - p["rest"])


def balancer(state: State, p: Mapping) -> Array:
    """Return the torque of a gas spring, of peak |(cos, sin)|.

    Close to sin q sin-parameter + cos q cos-parameter.
    """
    size, zero = np.hypot(p["cos"], p["sin"]), np.arctan2(-p["cos"], p["sin"])
    return size * laws.gas_spring(state.q - zero) / laws.gas_spring_peak()


def ripple(state: State, p: Mapping) -> Array:
    """Return the cogging of a magnet at order q + phase."""
    return p["amplitude"] * laws.magnet(p["order"] * state.q + p["phase"])
