"""Friction that grows with the load the gear carries (Bittencourt et al. 2010)."""

from residual.effects.base import Effect, EffectTrait, against_load, build_local_law

EFFECT = Effect(
    name="load_friction",
    noun="friction that grows with load",
    sentence="friction that grows with the torque that the gear carries",
    equation="tau = coefficient * |rigid-body torque| * sgn(qd)",
    parameters={"coefficient": "1"},
    **build_local_law("fabs(rigid) * sign"),
    traits=EffectTrait.USES_MODEL | EffectTrait.NOT_NEGATIVE | EffectTrait.FRICTION,
    # A load presses teeth and bearings together, which never lowers friction.
    variable=against_load,
    possible=lambda theta, shape, limits: bool(0 < theta[0] < 1),
    in_any_arm=lambda span, j: ((),),
)
