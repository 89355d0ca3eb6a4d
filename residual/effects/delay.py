"""Torque that is reported later than the angles it belongs to.

The column is (tau(t - a) - tau(t)) / a: its coefficient is the delay; the shape a only
sets the curvature.
"""

import numpy as np

from residual.effects.base import EARLIER, Effect, EffectTrait, ExportedLaw, ShapeRefinement

LARGEST = 0.05  # s: beyond it the two channels are unrelated
LEAST = 1e-4  # s: below it the difference is a derivative
FIRST = (0.006, 0.02)  # s: each finds delays of up to four times its own size


def _columns(state, joints, shape):
    (late,) = shape
    late = np.copysign(max(abs(late), LEAST), late)
    t = np.arange(len(state.t)) / state.rate
    then = [np.interp(t - late, t, column) for column in state.tau_model.T]
    return ((np.column_stack(then) - state.tau_model) / late)[:, :, None]


EFFECT = Effect(
    name="delay",
    noun="a delay between torque and position",
    sentence="torque that is reported later than the angles",
    equation="d tau(t) = tau(t - delay) - tau(t)",
    parameters={"delay": "s"},
    columns=_columns,
    scope="global",
    values=lambda theta, shape, robot: theta,
    from_values=lambda values, robot: (values, (float(values[0]),)),
    shapes=lambda span, j: tuple((a,) for a in FIRST),
    refine=ShapeRefinement("shift", 0.015, lower=LEAST, upper=LARGEST),
    traits=(EffectTrait.USES_MODEL | EffectTrait.MEMORY | EffectTrait.REPORT | EffectTrait.CHAIN),
    prior_sd=lambda robot: np.array([0.01]),
    # A report cannot be early, and the shape must have about that size.
    possible=lambda theta, shape, limits: bool(0 < theta[0] < 4 * max(shape[0], LEAST)),
    variable=lambda state, j: (
        np.gradient(state.tau_model[:, j], 1 / state.rate),
        f"rate of model torque {j + 1} [N m/s]",
    ),
    portable=ExportedLaw(
        formula=("a[0] * (earlier(m, t, tau, s[0]) - tau) / s[0]",),
        memory=EARLIER,
        # If the angles are late, torque looks ahead.
        possible=lambda theta, shape: shape[0] >= LEAST,
        obstacle="a negative delay looks ahead in time",
    ),
)
