"""A wrong torque constant or gear ratio: all torque of a joint reads scaled."""

import numpy as np

from residual.effects.base import Effect, EffectTrait, against_torque, build_local_law

MOST = 10.0  # a larger factor is a wrong unit


EFFECT = Effect(
    name="torque_gain",
    noun="a torque scale error",
    sentence="measured torque scaled by a wrong torque constant",
    equation="d tau = gain * tau",
    parameters={"gain": "1"},
    **build_local_law("tau"),
    traits=EffectTrait.USES_MODEL
    | EffectTrait.REPORT
    | EffectTrait.ONE_VARIABLE
    | EffectTrait.MOTOR,
    # A torque constant is wrong by some per cent; a free gain would imitate any
    # missing model on a joint that the nominal explains badly.
    prior_sd=lambda robot: np.array([0.1]),
    variable=against_torque,
    possible=lambda theta, shape, limits: bool(-1 < theta[0] < MOST),
)
