"""Inertia of motor rotor and gear, reflected to the joint."""

from residual.effects.base import Effect, Trait, against, formula, local, stays_positive

EFFECT = Effect(
    name="rotor_inertia",
    noun="rotor inertia",
    sentence="inertia of the motor's rotor, multiplied by the gear ratio squared",
    equation="tau = inertia * qdd",
    parameters={"inertia": "kg m^2"},
    columns=local(lambda state, j, shape: [state.qdd[:, j]]),
    traits=Trait.PARAMETER | Trait.NOT_NEGATIVE | Trait.GROUPABLE,
    drive_order=3,
    carries="acceleration",
    variable=against("qdd", "qdd{} [rad/s^2]"),
    possible=stays_positive,
    portable=formula("a[0] * qdd", joint=("armature",)),
)
