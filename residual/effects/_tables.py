"""Tables on the state of a joint: what a model may have, and nobody is told a name of.

Piecewise linear over nominal levels (G2017 section 2.6.1). Their shape is the knots.
"""

import numpy as np

from residual.effects.base import Effect, local
from residual.recording import Array


def _hats(x: Array, knots) -> Array:
    """Piecewise linear functions, one per knot, that sum to one. Shape (n, k)."""
    return np.column_stack([np.interp(x, knots, one) for one in np.eye(len(knots))])


def _speed(state, j, shape):
    hats, sign = _hats(np.abs(state.qd[:, j]), shape), state.sign[:, [j]]
    return [hats * (1 + sign) / 2, hats * (1 - sign) / 2]


def _position(state, j, shape):
    return [_hats(state.q[:, j], shape)]


def _load(state, j, shape):
    load, sign = state.rigid[:, j], state.sign[:, [j]]
    size = sorted(abs(x) for x in shape)
    return [_hats(load, shape), _hats(np.abs(load), size) * sign]


def _table(name: str, feature) -> Effect:
    return Effect(
        name=name,
        sentence="what else depends on the state of the joint",
        parameters={},
        columns=local(feature),
    )


STATES = (
    _table("table_of_speed", _speed),
    _table("table_of_position", _position),
    _table("table_of_load", _load),
)
TABLES = {effect.name: effect for effect in STATES}
