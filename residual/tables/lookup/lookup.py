"""A fitted correction as small tables: for each row some reads and a sum.

The paper's "look up table of coefficients" (section 2.6.2): B f_pls of eq. 31.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from residual.errors import InputError
from residual.lazy import Lazy
from residual.recording import Array
from residual.tables.blocks import as_block, frozen
from residual.tables.lookup.pack import Axis, Table, pack

kernels = Lazy("residual.tables.lookup.kernels")

_ARRAYS = ("offset", "slope", "low", "high")


# No slots: the packed form is made once and kept in the instance.
@dataclass(frozen=True, eq=False, repr=False)
class Lookup:
    """y = offset + x slope + the sum of all tables at the levels of x.

    Attributes:
        names: Variables, in the order of X's columns.
        joints: Names of the responses.
        axes, tables: Levels, and corrections on them.
        offset: Shape (j,).
        slope: Shape (d, j); zero where nothing is linear.
        low, high: Calibrated range. Shape (d,).
    """

    names: tuple[str, ...]
    joints: tuple[str, ...]
    axes: tuple[Axis, ...]
    tables: tuple[Table, ...]
    offset: Array
    slope: Array
    low: Array
    high: Array

    def __repr__(self) -> str:
        return (
            f"Lookup({', '.join(self.names)} -> {', '.join(self.joints)}: "
            f"{len(self.tables)} tables)"
        )

    def predict(self, X: Array) -> Array:
        """Return the correction of rows, in units of the responses. Shape (m, j).

        Raises:
            InputError: On another number of columns or a value that is not finite.
        """
        X = np.ascontiguousarray(self._checked(X))
        out = np.empty((len(X), len(self.joints)))
        kernels.evaluate_rows(X, self.packed, out)
        return out

    def predict_row(self, x: Array, out: Array) -> None:
        """Write the correction of one row into `out`, unchecked: for control loops.

        Args:
            x: Variables; float64. Shape (d,).
            out: Where the correction goes; float64. Shape (j,).
        """
        kernels.evaluate_row(x, self.packed, out)

    def outside(self, X: Array) -> Array:
        """Values outside the calibrated range, which take the nearest level. (m, d)."""
        X = self._checked(X)
        return np.less(X, self.low) | np.greater(X, self.high)

    def predict_levels(self, levels: Array) -> Array:
        """Return offset and tables at levels that are known; the slope needs values.

        Args:
            levels: Level of each row on each axis, from 0; unsigned, 1 or 2 bytes.
                Shape (m, axes).
        """
        out = np.empty((len(levels), len(self.joints)))
        kernels.evaluate_levels(np.ascontiguousarray(levels), self.packed, out)
        return out

    @cached_property
    def packed(self) -> tuple[Array, ...]:
        """The arrays that the compiled evaluation reads (see `pack`)."""
        linear, span = (self.offset, self.slope), (self.low, self.high)
        return pack(self.axes, self.tables, linear, span)

    def to_record(self) -> dict:
        """The tables as plain values."""
        arrays = {name: getattr(self, name).tolist() for name in _ARRAYS}
        return {
            "names": list(self.names),
            "joints": list(self.joints),
            "axes": [
                {"variable": a.variable, "edges": a.edges.tolist()} for a in self.axes
            ],
            "tables": [
                {"axes": list(t.axes), "values": t.values.tolist()} for t in self.tables
            ],
            **arrays,
        }

    @classmethod
    def from_record(cls, record: Mapping) -> "Lookup":
        """The way back."""
        axes = [Axis(a["variable"], np.array(a["edges"])) for a in record["axes"]]
        tables = [
            Table(tuple(t["axes"]), np.array(t["values"])) for t in record["tables"]
        ]
        return cls(
            names=tuple(record["names"]),
            joints=tuple(record["joints"]),
            axes=tuple(axes),
            tables=tuple(tables),
            **{name: np.array(record[name]) for name in _ARRAYS},
        )

    def _checked(self, X: Array) -> Array:
        X = as_block(X, "X")
        if X.shape[1] != len(self.names):
            raise InputError(
                f"X has {X.shape[1]} columns, the tables are of {len(self.names)}: "
                f"{', '.join(self.names)}. Give these, in order."
            )
        return X


def no_slope(variables: int, joints: int) -> Array:
    """A linear part of zeros. Shape (d, j)."""
    return frozen(np.zeros((variables, joints)))


def live_tables(tables: Sequence[Table]) -> tuple[Table, ...]:
    """Leave out tables that are zero everywhere."""
    return tuple(t for t in tables if t.values.any())
