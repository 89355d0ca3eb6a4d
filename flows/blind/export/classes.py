"""Coarse classes of effects, so that programs with fewer kinds are judged fairly."""

from residual.effects import registry
from residual.effects.base import Effect

BODY, JOINT, OTHER = "body", "joint", "other"
_PLACES = {
    "local": "one joint",
    "link": "the joint that carries the link",
    "pair": "two joints",
    "flange": "the last joint",
    "global": "none",
}


def class_of(effect: Effect) -> str:
    """Return "body", "joint" (friction and rotor) or "other"."""
    if effect.carries == BODY or effect.of_link:
        return BODY
    # Two joints that share a gear share its friction.
    drive = effect.brakes or effect.carries == "acceleration" or effect.scope == "pair"
    return JOINT if drive else OTHER


def classes() -> dict[str, str]:
    """Return the class of every effect that has a name."""
    return {name: class_of(effect) for name, effect in sorted(registry().items())}


def words() -> dict[str, dict]:
    """Return every effect with its class, its joints, what it is, and its units."""
    return {
        name: {
            "class": class_of(effect),
            "joints": _PLACES[effect.scope],
            "is": effect.sentence,
            "parameters": dict(effect.parameters),
        }
        for name, effect in sorted(registry().items())
    }
