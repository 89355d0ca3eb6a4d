"""Inertia of motor rotor and gear, reflected to the joint."""

from residual.effects.base import Effect, against, formula, local, stays_positive

EFFECT = Effect(
    name="rotor_inertia",
    noun="rotor inertia",
    sentence="inertia of the motor's rotor, multiplied by the gear ratio squared",
    equation="tau = inertia * qdd",
    parameters={"inertia": "kg m^2"},
    columns=local(lambda state, j, shape: [state.qdd[:, j]]),
    is_parameter=True,
    usual_in_every_drive=3,
    carries="acceleration",
    not_negative=True,
    groupable=True,
    variable=against("qdd", "qdd{} [rad/s^2]"),
    possible=stays_positive,
    portable=formula("a[0] * qdd", joint=("armature",)),
)
