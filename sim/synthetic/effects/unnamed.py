"""Effects that no vocabulary has: the right answer to them is "unknown"."""

from collections.abc import Mapping

import numpy as np

from sim.synthetic.state import State

Array = np.ndarray


def vibration(state: State, p: Mapping) -> Array:
    """Return amplitude sin(2 pi frequency t + phase): driven by time, not by motion."""
    angle = 2 * np.pi * p["frequency"] * state.t + p["phase"]
    return p["amplitude"] * np.sin(angle)[:, None] * np.ones_like(state.q)


def cogging_sum(state: State, p: Mapping) -> Array:
    """Return amplitude cos(order (q_i + q_j)) on joint i, nothing on joint j."""
    torque = p["amplitude"] * np.cos(p["order"] * state.q.sum(axis=1))
    return np.column_stack([torque, np.zeros_like(torque)])


def random_walk(state: State, p: Mapping) -> Array:
    """Return a random walk of zero mean and standard deviation `amplitude`."""
    walk = state.rng.normal(size=state.q.shape).cumsum(axis=0)
    walk -= walk.mean(axis=0)
    return p["amplitude"] * walk / walk.std(axis=0)


def square_wave(state: State, p: Mapping) -> Array:
    """Return amplitude sign(sin(2 pi frequency t)): something switches on and off."""
    wave = np.sign(np.sin(2 * np.pi * p["frequency"] * state.t))
    return p["amplitude"] * wave[:, None] * np.ones_like(state.q)


def friction_jump(state: State, p: Mapping) -> Array:
    """Return level z in the second part of every log, from `share` of it on."""
    late = np.arange(len(state.t)) >= p["share"] * len(state.t)
    return p["level"] * late[:, None] * state.bristle
