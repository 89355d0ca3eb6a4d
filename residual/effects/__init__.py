"""The effects that a model may lack, one file each; the registry is the folder."""

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
