"""What an arm may hide, one file per effect; the registry is the folder listing.

A file has an ``EFFECT``, or ``EFFECTS`` where several are of one kin; one that begins
with ``_`` has none. The registry is read by `sim.plant.effect_catalogue` alone.
"""

from collections.abc import Iterable
from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from sim.effects.base import Effect


@cache
def load_effects() -> dict[str, Effect]:
    """Return every effect by name, in alphabetical order of the files."""
    names = sorted(m.name for m in iter_modules(__path__))
    modules = (
        import_module(f"{__name__}.{name}")
        for name in names
        if name != "base" and name[0] != "_"
    )
    kin = (getattr(m, "EFFECTS", None) or (m.EFFECT,) for m in modules)
    return {effect.name: effect for effects in kin for effect in effects}


_ADDED: dict[str, Effect] = {}


def register_effects(effects: Iterable[Effect]) -> None:
    """Let synthetic arms of this process hide more than the folder has.

    So a benchmark hides its own: they are known by name, and in no list.
    """
    _ADDED.update({effect.name: effect for effect in effects})


def find_effect_definition(name: str) -> Effect:
    """Return an effect of the folder, or one that was added."""
    return _ADDED[name] if name in _ADDED else load_effects()[name]
