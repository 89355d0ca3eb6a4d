"""Play in a gear: the link lies on the side to which its load pushes it.

The encoder is on the motor. When the load changes sign the link leaves the tooth and
flies freely across the gap, x'' = -load / inertia, until it hits the next tooth: a
delayed crossing, later for wider gaps. If grease or a stiff controller hold the link, it
crosses with its load at once.
"""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from residual.effects.base import Effect, EffectTrait, ExportedLaw, ShapeRefinement, against_load
from residual.effects.sensitivity import (
    compute_shift_torque,
    compute_time_derivatives,
    compute_torque_derivatives,
)
from residual.recording import Array

# The coefficient is the half gap, the shape the half gap of the simulated flight; a second
# number of the shape is the time of an instant crossing [s].
LEAST, MOST = 0.5, 2.0
TINY = 1e-7  # rad
WIDEST = 0.02  # rad
AT_ONCE = 64  # samples of a fall: most are shorter
HELD = 0.01  # s: shorter than the identification filter resolves
FUTURE = "its flight is differentiated by samples that are still to come"


def _columns(state, joints, shape):
    (j,) = joints
    gap = max(abs(shape[0]), TINY)
    if len(shape) > 1:
        side = gaussian_filter1d(np.sign(state.rigid[:, j]), shape[1] * state.rate)
    else:
        inertia = np.maximum(compute_torque_derivatives(state)[2][:, j, j], 1e-9)
        push = -state.rigid[:, j] / inertia
        side = _flight(push, gap, 1 / state.rate) / gap
    rates = compute_time_derivatives(state, side)
    return compute_shift_torque(state, j, side, rates)[:, :, None]


def _flight(push: Array, gap: float, dt: float) -> Array:
    """Link minus motor angle, between -gap and gap, under a push on the link [rad].

    It rests on a tooth until the push reverses, then falls from rest to the next.
    """
    place = np.empty(len(push))
    at, i = gap * np.sign(push[0]), 0
    while i < len(push):
        away = np.flatnonzero(push[i:] * at < 0) if at else [0]
        leaves = i + int(away[0]) if len(away) else len(push)
        place[i:leaves] = at
        fall = _fall(push[leaves:], at, gap, dt)
        i = leaves + len(fall)
        place[leaves:i] = fall
        at = place[i - 1]
    return place


def _fall(push: Array, start: float, gap: float, dt: float) -> Array:
    """Motion between the teeth, up to the first sample on a tooth."""
    some = AT_ONCE
    while True:
        way = start + dt * np.cumsum(dt * np.cumsum(push[:some]))
        hits = np.flatnonzero(np.abs(way) >= gap)
        if len(hits):
            return np.append(way[: hits[0]], gap * np.sign(way[hits[0]]))
        if some >= len(push):
            return way
        some *= 4


def _possible(theta, shape, limits):
    """A flight holds near its simulated gap; an instant crossing for any gap of a gear."""
    if len(shape) > 1:
        return bool(TINY < theta[0] < WIDEST)
    return bool(LEAST < theta[0] / shape[0] < MOST)


EFFECT = Effect(
    name="backlash",
    noun="gear backlash",
    sentence="play in a gear, crossed when the load changes its side",
    equation=(
        "d tau = dtau/dq_j x + dtau/dqd_j x' + dtau/dqdd_j x'', where x'' = -load "
        "/ inertia between the teeth, |x| <= half_gap"
    ),
    parameters={"half_gap": "rad"},
    columns=_columns,
    scope="link",
    values=lambda theta, shape, robot: theta,
    from_values=lambda values, robot: (values, (float(values[0]),)),
    shapes=lambda span, j: ((5e-4,), (1e-3,), (2e-3,), (4e-3,), (1e-3, HELD)),
    refine=ShapeRefinement("ratio", 0.7, lower=1e-5, upper=WIDEST),
    traits=EffectTrait.USES_MODEL | EffectTrait.MEMORY,
    prior_sd=lambda robot: np.array([2e-3]),
    possible=_possible,
    # If the load never changes sign it is an offset of the encoder.
    far_fetched=0.5,
    family="geometry",
    variable=against_load,
    portable=ExportedLaw(obstacle=FUTURE),
)
