"""Modules that are imported when something of them is first asked for."""

from importlib import import_module


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
