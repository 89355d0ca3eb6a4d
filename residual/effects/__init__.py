"""The effects that a model may lack, one file each; the registry is the folder."""

import re
from collections.abc import Iterable, Mapping
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pkgutil import iter_modules

from residual.effects.base import Effect, EffectTrait, MotionSpan
from residual.errors import InputError
from residual.plugins import load_plugins

_HELPERS = {"base", "sensitivity"}


@cache
def load_effects() -> dict[str, Effect]:
    """Every effect by name, in alphabetical order of the files; then plug-ins.

    Raises:
        InputError: If a plug-in is no effect, or has the name of another one.
    """
    every = (m.name for m in iter_modules(__path__))
    modules = (m for m in every if m not in _HELPERS and m[0] != "_")
    found = (import_module(f"{__name__}.{m}").EFFECT for m in sorted(modules))
    effects = {effect.name: effect for effect in found}
    for name, given in load_plugins("modelgap.effects").items():
        if not isinstance(given, Effect) or given.name != name or name in effects:
            raise InputError(
                f"The plug-in '{name}' (modelgap.effects) gives "
                f"{getattr(given, 'name', type(given).__name__)!r}, expected an Effect "
                "that is called as the entry point is, and as no other is."
            )
        effects[name] = given
    return effects


def find_effect(name: str) -> Effect | None:
    """Return an effect by its name, None for none; loads only its file if it is ours."""
    file = f"{__name__}.{name}"
    if re.fullmatch("[a-z][a-z_]*", name) and name not in _HELPERS and find_spec(file):
        return import_module(file).EFFECT
    return load_effects().get(name)


def list_motor_alternatives(name: str, span: MotionSpan) -> tuple[str, ...]:
    """Effects that logs of one drive cannot separate from a given one; none for other logs."""
    effects, motor = load_effects(), EffectTrait.MOTOR
    if not span.one_drive or motor not in effects[name].traits:
        return ()
    friction, powered = EffectTrait.FRICTION, EffectTrait.POWERED
    return tuple(
        other.name
        for other in effects.values()
        if motor in other.traits
        and other.name != name
        # A drive that is off in a part of the logs separates its damping from friction.
        and not (
            any(span.switched)
            and friction in other.traits & effects[name].traits
            and powered in other.traits ^ effects[name].traits
        )
    )


def list_effect_parameters() -> dict[str, Mapping[str, str]]:
    """Parameters of every effect with their SI units: what a robot.toml may declare."""
    return {name: effect.parameters for name, effect in load_effects().items()}


def map_joint_properties() -> dict[str, tuple[str, str]]:
    """Effects of every drive, by the corresponding property of a simulated joint.

    Returns:
        Name and parameter of the effect, by property of an MJCF.
    """
    usual = (e for e in load_effects().values() if e.drive_order)
    return {
        effect.portable.joint[0]: (effect.name, next(iter(effect.parameters)))
        for effect in sorted(usual, key=lambda e: e.drive_order)
    }


def number_reported_joints(name: str, joints: Iterable[int], dof: int) -> tuple[int, ...]:
    """Joints (from 1) as in a verdict: effects at the flange are on the last one.

    Joints of an unknown effect are unchanged.
    """
    effect = load_effects().get(name)
    at_flange = effect is not None and effect.scope == "flange"
    return (dof,) if at_flange else tuple(sorted(joints))
