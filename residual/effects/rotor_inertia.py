"""Inertia of motor rotor and gear, reflected to the joint."""

from residual.effects.base import (
    Effect,
    EffectTrait,
    build_local_law,
    plot_over_signal,
    stays_positive,
)

EFFECT = Effect(
    name="rotor_inertia",
    noun="rotor inertia",
    sentence="inertia of the motor's rotor, multiplied by the gear ratio squared",
    equation="tau = inertia * qdd",
    parameters={"inertia": "kg m^2"},
    **build_local_law("qdd", joint=("armature",)),
    traits=EffectTrait.PARAMETER | EffectTrait.NOT_NEGATIVE | EffectTrait.GROUPABLE,
    drive_order=3,
    carries="acceleration",
    variable=plot_over_signal("qdd", "qdd{} [rad/s^2]"),
    possible=stays_positive,
)
