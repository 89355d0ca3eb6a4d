"""Effects outside the library: the right answer to them is "unknown"."""

import numpy as np

from sim.effects.base import (
    Effect,
    Rng,
    TypicalJointSizes,
    build_row_function,
    draw_angle,
    draw_any_joint,
    draw_sign,
)
from sim.engine import friction_laws


def _size(rng: Rng, sizes: TypicalJointSizes) -> float:
    return rng.uniform(0.03, 0.06) * sizes.torque


def _vibration(p, t, rng):
    """Driven by time, not by motion."""
    return p["amplitude"] * np.sin(2 * np.pi * p["frequency"] * t + p["phase"])


def _square_wave(p, t, rng):
    """Something switches on and off."""
    return p["amplitude"] * np.sign(np.sin(2 * np.pi * p["frequency"] * t))


def _random_walk(p, t, rng):
    """Return a walk of zero mean and standard deviation `amplitude`."""
    walk = rng.normal(size=len(t)).cumsum()
    walk -= walk.mean()
    return p["amplitude"] * walk / walk.std()


def _wall(rng: Rng, sizes: TypicalJointSizes) -> dict[str, float]:
    side = draw_sign(rng)
    angle = sizes.centre + side * rng.uniform(0.1, 0.4) * sizes.amplitude
    stiffness = rng.uniform(0.5, 1.0) * sizes.torque
    return {"angle": angle, "stiffness": stiffness, "side": side}


EFFECTS = (
    Effect(
        name="x_vibration",
        parameters={"amplitude": "N m", "frequency": "Hz", "phase": "rad"},
        defaults={"phase": 0.0},
        draw=lambda rng, sizes: {
            "amplitude": _size(rng, sizes),
            "frequency": rng.uniform(2.0, 7.0),
            "phase": draw_angle(rng),
        },
        series=_vibration,
    ),
    Effect(
        name="x_square_wave",
        parameters={"amplitude": "N m", "frequency": "Hz"},
        draw=lambda rng, sizes: {
            "amplitude": _size(rng, sizes),
            "frequency": rng.uniform(0.2, 0.4),
        },
        series=_square_wave,
    ),
    Effect(
        name="x_random_walk",
        parameters={"amplitude": "N m"},
        draw=lambda rng, sizes: {"amplitude": _size(rng, sizes)},
        series=_random_walk,
    ),
    Effect(
        name="x_cogging_sum",
        parameters={"amplitude": "N m", "order": "1"},
        scope="pair",
        draw=lambda rng, sizes: {"amplitude": _size(rng, sizes), "order": rng.uniform(8.0, 14.0)},
        torque=lambda p, joints: (friction_laws.COGGING_SUM, p["amplitude"], p["order"], joints[1]),
    ),
    Effect(
        name="x_friction_jump",
        parameters={"level": "N m", "share": "1"},
        defaults={"share": 0.5},
        draw=lambda rng, sizes: {
            "level": rng.uniform(0.4, 0.8) * sizes.coulomb,
            "share": rng.uniform(0.4, 0.6),
        },
        friction=build_row_function(friction_laws.LEVEL, "level"),
        onset_share=lambda p: p["share"],
    ),
    Effect(
        name="x_dead_zone",
        parameters={"level": "N m"},
        above={"level": 0.0},
        where=draw_any_joint,
        draw=lambda rng, sizes: {"level": rng.uniform(0.02, 0.06) * sizes.torque},
        torque=build_row_function(friction_laws.DEAD_ZONE, "level"),
    ),
    Effect(
        name="x_wall",
        parameters={"angle": "rad", "stiffness": "N m/rad", "side": "1"},
        defaults={"side": 1.0},
        above={"stiffness": 0.0},
        signs=("side",),
        where=draw_any_joint,
        draw=_wall,
        torque=build_row_function(friction_laws.WALL, "stiffness", "angle", "side"),
    ),
)
