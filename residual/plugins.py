"""Effects, readers and exporters from other packages, by their entry points."""

from functools import cache
from importlib.metadata import entry_points
from typing import Any

from residual.errors import InputError


@cache
def load_plugins(group: str) -> dict[str, Any]:
    """Return the entry points of a group in other packages, by name.

    Args:
        group: "modelgap.effects", "modelgap.readers" or "modelgap.exporters".

    Raises:
        InputError: If one cannot be loaded, instead of silently omitting it.
    """
    loaded = {}
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        try:
            loaded[entry.name] = entry.load()
        except Exception as error:
            # A foreign package may raise any error.
            whose = entry.dist.name if entry.dist else entry.value
            raise InputError(
                f"The plug-in '{entry.name}' of {whose} ({group}) cannot be loaded: "
                f"{type(error).__name__}: {error}. Repair or uninstall {whose}."
            ) from error
    return loaded
