"""A fitted correction as small tables: for each row some reads and a sum; and as files.

The paper's "look up table of coefficients" (section 2.6.2): B f_pls of eq. 31.
"""

import csv
import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import resources
from itertools import pairwise
from pathlib import Path

import numpy as np

from residual.blocks import as_rows
from residual.quantity import plain
from residual.recording import Array

FORM = 1  # of the exported files; raised when they change


@dataclass(frozen=True, eq=False, slots=True)
class Axis:
    """Levels of one variable."""

    variable: int  # column of X, from 0
    edges: Array  # inner edges, increasing; a value at one belongs above, (k - 1,)


@dataclass(frozen=True, eq=False, slots=True)
class LookupTable:
    """Corrections by the levels of one axis or two."""

    axes: tuple[int, ...]  # numbers of its axes
    values: Array  # shape (k, j) or (k1, k2, j), in units of the responses


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Lookup:
    """y = offset + x slope + the sum of all tables at the levels of x."""

    names: tuple[str, ...]  # variables, in the order of X's columns
    joints: tuple[str, ...]  # names of the responses
    # Levels, and corrections on them.
    axes: tuple[Axis, ...]
    tables: tuple[LookupTable, ...]
    offset: Array  # , (j,)
    slope: Array  # shape (d, j); zero where nothing is linear
    # Calibrated range, (d,).
    low: Array
    high: Array

    def __repr__(self) -> str:
        return (
            f"Lookup({', '.join(self.names)} -> {', '.join(self.joints)}: "
            f"{len(self.tables)} tables)"
        )

    def predict(self, X: Array) -> Array:
        """Return the correction of rows, in units of the responses. Shape (m, j)."""
        X = as_rows(X, self.names, "the tables are of")
        levels = [
            np.searchsorted(a.edges, X[:, a.variable], "right") for a in self.axes
        ]
        out = self.offset + X @ self.slope
        for table in self.tables:
            out += table.values[tuple(levels[a] for a in table.axes)]
        return out

    def outside(self, X: Array) -> Array:
        """Values outside the calibrated range, which take the nearest level. (m, d)."""
        X = as_rows(X, self.names, "the tables are of")
        return np.less(X, self.low) | np.greater(X, self.high)

    def to_record(self) -> dict:
        """The tables as plain values."""
        return plain(asdict(self))

    @classmethod
    def from_record(cls, record: Mapping) -> "Lookup":
        """The way back."""
        axes = (Axis(a["variable"], np.array(a["edges"])) for a in record["axes"])
        tables = (
            LookupTable(tuple(t["axes"]), np.array(t["values"]))
            for t in record["tables"]
        )
        names, joints = tuple(record["names"]), tuple(record["joints"])
        arrays = (np.array(record[name]) for name in ("offset", "slope", "low", "high"))
        return cls(names, joints, tuple(axes), tuple(tables), *arrays)

    @classmethod
    def load(cls, path: str | Path) -> "Lookup":
        """Read the `model.npz` of an export."""
        with np.load(path) as file:
            axes = tuple(
                Axis(int(variable), file[f"edges_{i}"])
                for i, variable in enumerate(file["axis_variable"])
            )
            tables = tuple(
                LookupTable(tuple(int(a) for a in pair if a >= 0), file[f"values_{i}"])
                for i, pair in enumerate(file["table_axes"])
            )
            names, joints = (tuple(file[k].tolist()) for k in ("names", "joints"))
            arrays = (file[k] for k in ("offset", "slope", "low", "high"))
            return cls(names, joints, axes, tables, *arrays)


def export_lookup(lookup: Lookup) -> dict[str, bytes]:
    """Return the files of an export by name; the same bytes for the same tables.

    `model.npz` holds everything, `tables.csv` the same cells to read, `model.json` what
    the tables are, `evaluate.py` evaluates the NPZ with numpy alone.
    """
    evaluator = resources.files(__package__).joinpath("evaluate.py")
    return {
        "model.npz": _npz(lookup),
        "tables.csv": _csv(lookup),
        "model.json": _json(lookup),
        "evaluate.py": evaluator.read_bytes(),
    }


def _npz(lookup: Lookup) -> bytes:
    named = ("names", "joints", "offset", "slope", "low", "high")
    arrays = {name: np.array(getattr(lookup, name)) for name in named}
    places = [(*t.axes, -1)[:2] for t in lookup.tables]
    arrays["axis_variable"] = np.array([a.variable for a in lookup.axes], np.int64)
    arrays["table_axes"] = np.array(places, np.int64).reshape(-1, 2)
    arrays |= {f"edges_{i}": a.edges for i, a in enumerate(lookup.axes)}
    arrays |= {f"values_{i}": t.values for i, t in enumerate(lookup.tables)}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def _csv(lookup: Lookup) -> bytes:
    """One line per cell: its intervals [from, to) and its value for each joint."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    sides = [f"{side}_{n}" for n in (1, 2) for side in ("variable", "from", "to")]
    out.writerow(["table", *sides, *lookup.joints])
    out.writerow(["offset", *[""] * 6, *map(repr, lookup.offset.tolist())])
    for name, slope in zip(lookup.names, lookup.slope.tolist(), strict=True):
        if any(slope):
            out.writerow(["slope", name, *[""] * 5, *map(repr, slope)])
    for number, table in enumerate(lookup.tables):
        bounds = []
        for axis in (lookup.axes[i] for i in table.axes):
            edges = pairwise(["-inf", *map(repr, axis.edges.tolist()), "inf"])
            bounds.append([(lookup.names[axis.variable], *pair) for pair in edges])
        flat = table.values.reshape(-1, len(lookup.joints)).tolist()
        cells = np.ndindex(table.values.shape[:-1])
        for place, values in zip(cells, flat, strict=True):
            interval = [w for b, k in zip(bounds, place, strict=True) for w in b[k]]
            interval += [""] * (6 - len(interval))
            out.writerow([number, *interval, *map(repr, values)])
    return text.getvalue().encode()


def _json(lookup: Lookup) -> bytes:
    content = {
        "form": FORM,
        "meaning": "correction [N m] = offset + x slope + sum of tables; x in rad, "
        "rad/s, rad/s^2, of tau in N m (torque of the model); a value at an edge "
        "belongs above it",
        "variables": [
            {"name": n, "low": float(a), "high": float(b)}
            for n, a, b in zip(lookup.names, lookup.low, lookup.high, strict=True)
        ],
        "joints": list(lookup.joints),
        "offset": lookup.offset.tolist(),
        "slope": lookup.slope.tolist(),
        "axes": [
            {"variable": lookup.names[a.variable], "edges": a.edges.tolist()}
            for a in lookup.axes
        ],
        "tables": [
            {
                "table": number,
                "axes": list(t.axes),
                "variables": [lookup.names[lookup.axes[a].variable] for a in t.axes],
                "levels": list(t.values.shape[:-1]),
                "largest": np.abs(t.values)
                .max(axis=(*range(t.values.ndim - 1),))
                .tolist(),
            }
            for number, t in enumerate(lookup.tables)
        ],
    }
    return (json.dumps(content, indent=1) + "\n").encode()
