"""Axes of look-up tables, and the tables on them."""

from dataclasses import dataclass

from residual.recording import Array


@dataclass(frozen=True, eq=False, slots=True)
class Axis:
    """Levels of one variable.

    Attributes:
        variable: Column of X, from 0.
        edges: Inner edges, increasing; a value at one belongs above. Shape (k - 1,).
    """

    variable: int
    edges: Array


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """Corrections by the levels of one axis or two.

    Attributes:
        axes: Numbers of its axes.
        values: Shape (k, j) or (k1, k2, j), in units of the responses.
    """

    axes: tuple[int, ...]
    values: Array
