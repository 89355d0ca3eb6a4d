"""How much of an effect there is: the parameters that make it larger in proportion."""

from collections.abc import Mapping

import numpy as np

# The first is the one that the size is told in; several are one vector, told by its
# length. What is not here has no size that its torque is in proportion to.
_IN_PROPORTION: dict[str, tuple[str, ...]] = {
    "viscous": ("coefficient",),
    "coulomb": ("level",),
    "rotor_inertia": ("inertia",),
    "link_inertia": ("scale",),
    "payload": ("mass",),
    "offset": ("torque",),
    "coulomb_asymmetry": ("level",),
    "viscous_asymmetry": ("coefficient",),
    "quadratic_viscous": ("coefficient",),
    "power_viscous": ("coefficient",),
    "stribeck": ("level",),
    "load_friction": ("coefficient",),
    "position_friction": ("cos", "sin"),
    "coupled_friction": ("level",),
    "warmup": ("level",),
    "spring": ("stiffness",),
    "balancer": ("cos", "sin"),
    "ripple": ("amplitude",),
    "torque_gain": ("gain",),
    "encoder_offset": ("angle",),
    "encoder_eccentricity": ("cos", "sin"),
    "backlash": ("half_gap",),
    "base_tilt": ("tilt_x", "tilt_y"),
    "delay": ("delay",),
    "tool_force": ("x", "y", "z"),
}
# The softer, the more of it there is: the size is told in the parameter itself.
_IN_INVERSE = {"elasticity": "stiffness"}
# What grows along without being the size.
_ALONG = {"coupled_friction": ("coefficient", "inertia")}


def amount(name: str, parameters: Mapping[str, float]) -> float | None:
    """Return how much there is of an effect, without sign: its torque grows with it.

    In the unit of its first parameter, or the inverse of that (compliance of a gear).

    Args:
        name: Name of the effect.
        parameters: Its parameters, SI.

    Returns:
        The amount, None for an effect that has none in proportion to its torque
        (presliding, saturation, all out of the vocabulary).
    """
    if name in _IN_INVERSE:
        return 1.0 / abs(parameters[_IN_INVERSE[name]])
    keys = _IN_PROPORTION.get(name)
    if keys is None:
        return None
    return float(np.linalg.norm([parameters[key] for key in keys]))


def as_told(name: str, value: float) -> float:
    """Return an amount as the size that people say, or the other way round."""
    return 1.0 / value if name in _IN_INVERSE else value


def multiplied(
    name: str, parameters: Mapping[str, float], factor: float
) -> dict[str, float]:
    """Return the parameters of the same effect, larger by a factor.

    Raises:
        KeyError: If the effect has no size in proportion to its torque.
    """
    if name in _IN_INVERSE:
        key = _IN_INVERSE[name]
        return {**parameters, key: parameters[key] / factor}
    keys = (*_IN_PROPORTION[name], *_ALONG.get(name, ()))
    return {k: v * factor if k in keys else v for k, v in parameters.items()}


def main_parameter(name: str, parameters: Mapping[str, float]) -> str | None:
    """Return the key that an estimate is judged by: of a vector its largest part."""
    keys = [key for key in _IN_PROPORTION.get(name, ()) if key in parameters]
    if not keys:
        return next(iter(parameters), None)
    return max(keys, key=lambda key: abs(parameters[key]))
