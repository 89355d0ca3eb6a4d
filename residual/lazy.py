"""What is loaded: modules when asked for, plug-ins, one thread of linear algebra."""

from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from threadpoolctl import threadpool_limits

from residual.errors import InputError


class Lazy:
    """A module by its name, in place of the module: not every run needs it.

    Stands at the top of a file, where an import would. For what is slow to load
    (compiled loops, SQL, an object store) or of use to a few commands only.
    """

    def __init__(self, name: str) -> None:
        """Name the module."""
        self._name = name

    def __getattr__(self, attribute: str):
        return getattr(import_module(self._name), attribute)


@cache
def plugins(group: str) -> dict[str, Any]:
    """Return what other packages give under the entry points of a group, by name.

    Args:
        group: "modelgap.effects", "modelgap.readers" or "modelgap.exporters".

    Raises:
        InputError: If one cannot be loaded: half of a registry would be a silent one.
    """
    found = {}
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        try:
            found[entry.name] = entry.load()
        except Exception as error:
            # What a stranger's package raises is not on any list.
            whose = entry.dist.name if entry.dist else entry.value
            raise InputError(
                f"The plug-in '{entry.name}' of {whose} ({group}) cannot be loaded: "
                f"{type(error).__name__}: {error}. Repair or uninstall {whose}."
            ) from error
    return found


# The one place that limits threads of the linear algebra.


# The products are small: two threads on them wait for each other, up to twenty times
# longer than one works. A decorator of what does the work; what a program that
# imports us has set holds again when it is done.
one_blas_thread = threadpool_limits.wrap(limits=1, user_api="blas")
