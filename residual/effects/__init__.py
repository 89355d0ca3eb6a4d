"""The effects that a model may lack, one file each; the registry is the folder."""

from collections.abc import Iterable, Mapping
from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from residual.effects.base import Effect


@cache
def registry() -> dict[str, Effect]:
    """Every effect by name, in alphabetical order of the files."""
    modules = (
        m.name for m in iter_modules(__path__) if m.name != "base" and m.name[0] != "_"
    )
    found = (import_module(f"{__name__}.{m}").EFFECT for m in sorted(modules))
    return {effect.name: effect for effect in found}


def vocabulary() -> dict[str, Mapping[str, str]]:
    """Parameters of every effect with their SI units: what a robot.toml may declare."""
    return {name: effect.parameters for name, effect in registry().items()}


def reported_joints(name: str, joints: Iterable[int], dof: int) -> tuple[int, ...]:
    """Joints (from 1) as a verdict has them: what is at the flange is on the last.

    Args:
        name: Name of an effect; one that nobody looks for stays where it is.
        joints: Joints on which an arm has it, from 1.
    """
    effect = registry().get(name)
    at_flange = effect is not None and effect.scope == "flange"
    return (dof,) if at_flange else tuple(sorted(joints))
