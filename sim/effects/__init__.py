"""Effects that an arm may hide, one file each; the registry is the folder listing.

A file has an ``EFFECT``, or ``EFFECTS`` for several related ones; one that begins
with ``_`` has none. The registry is read by `sim.plant.effect_catalogue` alone.
"""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from sim.effects.base import Effect


@cache
def load_effects() -> dict[str, Effect]:
    """Return every effect by name, in alphabetical order of the files."""
    names = sorted(m.name for m in iter_modules(__path__))
    modules = (
        import_module(f"{__name__}.{name}") for name in names if name != "base" and name[0] != "_"
    )
    kin = (getattr(m, "EFFECTS", None) or (m.EFFECT,) for m in modules)
    return {effect.name: effect for effects in kin for effect in effects}
