"""Torques that follow a clock or chance, for a whole motion at once."""

import numpy as np

from sim.plant.perturbations import parameters
from sim.plant.rows import series_columns
from sim.records import PlantEffect
from sim.synthetic.seeds import stream

Array = np.ndarray


def series_of(
    effects: tuple[PlantEffect, ...], t: Array, seed: int, label: str
) -> Array:
    """Return the torque over time of every such effect and joint.

    Args:
        effects: All effects of the arm.
        t: Session time [s]. Shape (n,).
        seed: Seed of the arm.
        label: Name of the motion; chance differs from motion to motion.

    Returns:
        Torques [N m], columns as `series_columns` says. Shape (n, s).
    """
    columns = series_columns(effects)
    out = np.zeros((len(t), len(columns)))
    for (i, joint), column in columns.items():
        rng = stream(seed, f"effect/{i}/{effects[i].name}/{joint}/{label}")
        out[:, column] = _torque(effects[i], t, rng)
    return out


def _torque(effect: PlantEffect, t: Array, rng: np.random.Generator) -> Array:
    p = parameters(effect)
    if effect.name == "x_random_walk":
        walk = rng.normal(size=len(t)).cumsum()
        walk -= walk.mean()
        return p["amplitude"] * walk / walk.std()
    wave = np.sin(2 * np.pi * p["frequency"] * t + p.get("phase", 0.0))
    return p["amplitude"] * (np.sign(wave) if effect.name == "x_square_wave" else wave)
