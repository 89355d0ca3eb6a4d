"""An arm not upright: to first order |g| (tilt_x, tilt_y, 0) is added to gravity."""

import numpy as np
import pinocchio as pin

from sim.effects.base import Effect, PlantEffectTrait, draw_angle, split_into_components


def _tilted(model, joints, p):
    changed, gravity = pin.Model(model), model.gravity.linear
    axis = np.cross(gravity, [p["tilt_x"], p["tilt_y"], 0.0])
    changed.gravity.linear = pin.exp3(axis / np.linalg.norm(gravity)) @ gravity
    return changed


EFFECT = Effect(
    name="base_tilt",
    parameters={"tilt_x": "rad", "tilt_y": "rad"},
    defaults={"tilt_x": 0.0, "tilt_y": 0.0},
    scope="global",
    amount=("tilt_x", "tilt_y"),
    traits=frozenset({PlantEffectTrait.RARE}),
    draw=lambda rng, sizes: split_into_components(
        np.deg2rad(rng.uniform(1.0, 4.0)), draw_angle(rng), ("tilt_x", "tilt_y")
    ),
    body=_tilted,
)
