"""Damping of a drive while it is on: back EMF in a closed bridge."""

import numpy as np

from residual.effects.base import (
    Effect,
    EffectTrait,
    ExportedLaw,
    build_joint_columns,
    dissipates_with_speed,
)


def _speed_while_on(state, j: int, shape) -> list[np.ndarray]:
    on = 1.0 if state.enabled is None else state.enabled[:, j]
    return [state.qd[:, j] * on]


EFFECT = Effect(
    name="drive_damping",
    noun="damping by the drive",
    sentence="resistance proportional to speed while the drive is on (back EMF)",
    equation="tau = coefficient * qd: while the drive is on",
    parameters={"coefficient": "N m s/rad"},
    columns=build_joint_columns(_speed_while_on),
    traits=EffectTrait.PARAMETER
    | EffectTrait.NOT_NEGATIVE
    | EffectTrait.FRICTION
    | EffectTrait.MOTOR
    | EffectTrait.POWERED,
    possible=dissipates_with_speed,
    # With a drive that is always on it is indistinguishable from viscous friction.
    shapes=lambda span, j: ((),) if span.switched and span.switched[j] else (),
    portable=ExportedLaw(("a[0] * qd",), joint=("damping",)),
)
