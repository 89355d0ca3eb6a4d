"""Inertia of motor rotor and gear, reflected to the joint."""

from residual.effects.base import Effect, formula, local, stays_positive


def _over_acceleration(state, j):
    return state.qdd[:, j], f"qdd{j + 1} [rad/s^2]"


def _feature(state, j, shape):
    return [state.qdd[:, j]]


EFFECT = Effect(
    name="rotor_inertia",
    noun="rotor inertia",
    sentence="inertia of the motor's rotor, multiplied by the gear ratio squared",
    equation="tau = inertia * qdd",
    parameters={"inertia": "kg m^2"},
    columns=local(_feature),
    is_parameter=True,
    usual_in_every_drive=3,
    carries="acceleration",
    not_negative=True,
    groupable=True,
    variable=_over_acceleration,
    possible=stays_positive,
    portable=formula("a[0] * qdd", joint=("armature",)),
)
