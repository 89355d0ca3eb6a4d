"""The figure of a round trip through a target."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

import numpy as np

from residual.errors import InputError
from residual.export.exported import Exported
from residual.recording import Array


@dataclass(frozen=True, slots=True)
class Proof:
    """Torque of the exported model as its target computes it, against ours.

    Attributes:
        by: What computed it.
        states: On how many states.
        difference: Largest difference from what the export carries [N m]; None where
            it could not be tried.
        torque: Largest torque among them [N m].
        notes: What else is to be known, a line each.
    """

    by: str
    states: int
    difference: float | None
    torque: float
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        if self.difference is None:
            return f"round trip: not tried; {self.by}"
        return (
            f"round trip: {self.by} on {self.states} states: largest difference from "
            f"what is carried {self.difference:.2g} N m, of {self.torque:.3g} N m"
        )


Prove = Callable[[Exported], Proof]


def compared(by: str, got: Array, want: Array, notes: tuple[str, ...] = ()) -> Proof:
    """Return the proof of two torques.

    Args:
        got: Torque of the target [N m]. Shape (n, dof).
        want: Torque of what the export carries [N m]. Shape (n, dof).
    """
    gap, size = np.abs(got - want).max(), np.abs(want).max()
    return Proof(by, len(want), float(gap), float(size), notes)


def text_of(made: Exported) -> str:
    """Return the first file of an export as text."""
    return next(iter(made.files.values())).decode()


def extra(package: str) -> ModuleType:
    """Return a package of the extra, which is loaded only when it is needed.

    Raises:
        InputError: If it is not installed.
    """
    try:
        return import_module(package)
    except ImportError as error:
        raise InputError(
            f"This target needs {error.name}, which is not installed. Install the "
            "extra: pip install '.[export]' in the checkout."
        ) from error
