"""How much of an effect there is, and which numbers say so."""

import operator
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effects import load_effects
from sim.effects.base import PlantEffectTrait
from sim.engine.plant_records import PlantEffect


def list_unnamed_effects() -> list[str]:
    """Return the names of those that no vocabulary has, broken sensors apart."""
    return [
        name
        for name, effect in load_effects().items()
        if not effect.named and PlantEffectTrait.SENSOR not in effect.traits
    ]


def compute_effect_amount(name: str, parameters: Mapping[str, float]) -> float | None:
    """Return how much there is of an effect, without sign: its torque grows with it.

    In the unit of its first parameter, or the inverse of that (compliance of a gear).

    Returns:
        The amount, None for an effect that has none in proportion to its torque
        (presliding, saturation, all out of the vocabulary).
    """
    effect = load_effects().get(name)
    if effect is None or not effect.amount:
        return None
    size = float(np.linalg.norm([parameters[key] for key in effect.amount]))
    return convert_stated_size(name, size)


def convert_stated_size(name: str, x: float) -> float:
    """Return an amount as the size that people state, or the other way round."""
    return 1.0 / x if PlantEffectTrait.INVERSE in load_effects()[name].traits else x


def scale_effect(effect: PlantEffect, factor: float) -> PlantEffect:
    """Return the same effect, larger by a factor."""
    kind = load_effects()[effect.name]
    scaled = operator.truediv if PlantEffectTrait.INVERSE in kind.traits else operator.mul
    grows = (*kind.amount, *kind.along)
    values = ((k, scaled(v, factor) if k in grows else v) for k, v in effect.parameters)
    return replace(effect, parameters=tuple(sorted(values)))


def find_main_parameter(name: str, parameters: Mapping[str, float]) -> str | None:
    """Return the key that an estimate is judged by: of a vector its largest part."""
    effect = load_effects().get(name)
    keys = [key for key in effect.amount if key in parameters] if effect else []
    if not keys:
        return next(iter(parameters), None)
    return max(keys, key=lambda key: abs(parameters[key]))
