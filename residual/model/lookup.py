"""A fitted correction as small tables: for each row some reads and a sum; and as files.

The paper's "look up table of coefficients" (section 2.6.2): B f_pls of eq. 31.

Three pair tables over the same three axes are one table of three axes: their sum. Nine
variables have 36 pairs, and twelve triples hold each of them once (a Steiner system):
a row takes 12 reads and not 36.
"""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib import resources
from itertools import pairwise
from math import prod
from pathlib import Path

import numpy as np

from residual.blocks import as_rows
from residual.quantity import plain
from residual.recording import Array

GRID = 1024  # steps per axis that lead to a level without a search
CUBE = 32_768  # cells that a table of three axes may have: 1 MB for four joints
TRIES = 2_000  # steps of the search for triples: plenty for 9 axes
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


Pieces = tuple[Array, Array]


def pack(
    axes: Sequence[Axis], tables: Sequence[LookupTable], linear: Pieces, span: Pieces
) -> tuple[Array, ...]:
    """Return the arrays that the compiled evaluation reads.

    Args:
        linear: Offset and slope of the linear part. Shapes (j,), (d, j).
        span: Lowest and highest calibrated value of each variable. Shapes (d,).

    Returns:
        axes (a, 2): variable and place of the first edge; grid (a, 2): lowest value
        and steps per unit; starts (a, GRID): least level in each step; edges, each axis
        closed by infinity; places (t, 6): first cell, three axes, cells per level of
        the first and second; linear (1 + d, w): offset and slope; cells (c, w), with w
        the joints filled up with zeros to a multiple of 4.
    """
    sizes, joints = [len(axis.edges) + 1 for axis in axes], len(linear[0])
    joined: dict[tuple[int, ...], Array] = {}
    for table in tables:
        known = joined.get(table.axes)
        joined[table.axes] = table.values if known is None else known + table.values
    for a, b, c in find_triples([t for t in joined if len(t) == 2], sizes):
        cube = joined.pop((a, b))[:, :, None] + joined.pop((a, c))[:, None]
        joined[a, b, c] = cube + joined.pop((b, c))[None]
    missing = (0, 0), (0, -joints % 4)
    places, cells = _places(joined, joints)
    return (
        *_grids(axes, *span),
        places,
        np.pad(np.vstack(linear), missing),
        np.pad(cells, missing),
    )


def find_triples(pairs: Sequence[tuple[int, int]], sizes: Sequence[int]) -> list[tuple]:
    """Choose triples of axes whose three pairs are all given, no pair used twice.

    As many as a search of bounded length finds; of the axes, with so many levels each,
    no triple may have more than CUBE cells. The smaller axis of a pair comes first.
    """
    best: list[tuple] = []
    tries = 0

    def search(unused: frozenset, chosen: list[tuple]) -> None:
        nonlocal best, tries
        tries += 1
        if len(chosen) > len(best):
            best = chosen
        if tries > TRIES or len(chosen) + len(unused) // 3 <= len(best):
            return
        a, b = min(unused)
        for c in range(b + 1, len(sizes)):
            sides = {(a, b), (a, c), (b, c)}
            if sides <= unused and prod(sizes[i] for i in (a, b, c)) <= CUBE:
                search(unused - sides, [*chosen, (a, b, c)])
        search(unused - {(a, b)}, chosen)

    search(frozenset(p for p in pairs if p[0] < p[1]), [])
    return best


def _places(tables: Mapping[tuple[int, ...], Array], joints: int) -> tuple:
    places, cells, start = [], [np.zeros((1, joints))], 1
    for axes, values in tables.items():
        # Fewer axes: the first is repeated, with no cells per level.
        a, b, c = (axes[0],) * (3 - len(axes)) + axes
        shape = (1, 1, *values.shape[:-1])
        first = shape[-1] * shape[-2] if len(axes) == 3 else 0
        places.append((start, a, b, c, first, shape[-1] if len(axes) > 1 else 0))
        cells.append(values.reshape(-1, joints))
        start += len(cells[-1])
    return np.array(places, np.uint64).reshape(-1, 6), np.concatenate(cells)


def _grids(axes: Sequence[Axis], low: Array, high: Array) -> tuple[Array, ...]:
    first, starts, grid, edges = [], [], [], []
    for axis in axes:
        lowest = low[axis.variable]
        rate = GRID / max(high[axis.variable] - lowest, 1e-300)
        steps = lowest + np.arange(GRID) / rate
        starts.append(np.searchsorted(axis.edges, steps, side="right"))
        grid.append((lowest, rate))
        first.append((axis.variable, sum(map(len, edges))))
        edges.append(np.append(axis.edges, np.inf))
    return (
        np.array(first, np.int64).reshape(-1, 2),
        np.array(grid, float).reshape(-1, 2),
        np.array(starts, np.int64).reshape(-1, GRID),
        np.concatenate([*edges, [np.inf]]),
    )


# No slots: the packed form is made once and kept in the instance.
@dataclass(frozen=True, eq=False, repr=False)
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
        from residual.model.lookup_kernels import evaluate_rows

        X = np.ascontiguousarray(as_rows(X, self.names, "the tables are of"))
        out = np.empty((len(X), len(self.joints)))
        evaluate_rows(X, self.packed, out)
        return out

    def outside(self, X: Array) -> Array:
        """Values outside the calibrated range, which take the nearest level. (m, d)."""
        X = as_rows(X, self.names, "the tables are of")
        return np.less(X, self.low) | np.greater(X, self.high)

    @cached_property
    def packed(self) -> tuple[Array, ...]:
        """The arrays that the compiled evaluation reads (see `pack`)."""
        linear, span = (self.offset, self.slope), (self.low, self.high)
        return pack(self.axes, self.tables, linear, span)

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
        with np.load(path) as held:
            axes = tuple(
                Axis(int(variable), held[f"edges_{i}"])
                for i, variable in enumerate(held["axis_variable"])
            )
            tables = tuple(
                LookupTable(tuple(int(a) for a in pair if a >= 0), held[f"values_{i}"])
                for i, pair in enumerate(held["table_axes"])
            )
            names, joints = (tuple(held[k].tolist()) for k in ("names", "joints"))
            arrays = (held[k] for k in ("offset", "slope", "low", "high"))
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
        bounds = [_intervals(lookup, axis) for axis in table.axes]
        flat = table.values.reshape(-1, len(lookup.joints)).tolist()
        cells = np.ndindex(table.values.shape[:-1])
        for place, values in zip(cells, flat, strict=True):
            told = [w for b, k in zip(bounds, place, strict=True) for w in b[k]]
            told += [""] * (6 - len(told))
            out.writerow([number, *told, *map(repr, values)])
    return text.getvalue().encode()


def _intervals(lookup: Lookup, axis: int) -> list[tuple[str, str, str]]:
    chosen = lookup.axes[axis]
    name, edges = lookup.names[chosen.variable], map(repr, chosen.edges.tolist())
    return [(name, *pair) for pair in pairwise(["-inf", *edges, "inf"])]


def _json(lookup: Lookup) -> bytes:
    told = {
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
    return (json.dumps(told, indent=1) + "\n").encode()
