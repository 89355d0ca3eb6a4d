"""The tables as files: NPZ, CSV, JSON, and a program that evaluates them."""

import csv
import io
import json
from importlib import resources

import numpy as np

from residual.recording import Array
from residual.tables.lookup.lookup import Lookup

FORM = 1  # of the exported files; raised when they change


def export_lookup(lookup: Lookup) -> dict[str, bytes]:
    """Return the files of an export by name; whoever calls writes them.

    `model.npz` holds everything, `tables.csv` the same cells to read, `model.json` what
    the tables are, `evaluate.py` evaluates the NPZ with numpy alone.

    Returns:
        File name and content; the same bytes for the same tables.
    """
    evaluator = resources.files(__package__).joinpath("evaluate.py")
    return {
        "model.npz": _npz(lookup),
        "tables.csv": _csv(lookup),
        "model.json": _json(lookup),
        "evaluate.py": evaluator.read_bytes(),
    }


def _npz(lookup: Lookup) -> bytes:
    arrays = {
        "names": np.array(lookup.names),
        "joints": np.array(lookup.joints),
        "offset": lookup.offset,
        "slope": lookup.slope,
        "low": lookup.low,
        "high": lookup.high,
        "axis_variable": np.array([a.variable for a in lookup.axes], np.int64),
        "table_axes": np.array(
            [(*t.axes, -1)[:2] for t in lookup.tables], np.int64
        ).reshape(-1, 2),
    }
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
        for place, values in zip(
            np.ndindex(table.values.shape[:-1]), flat, strict=True
        ):
            told = [w for b, k in zip(bounds, place, strict=True) for w in b[k]]
            told += [""] * (6 - len(told))
            out.writerow([number, *told, *map(repr, values)])
    return text.getvalue().encode()


def _intervals(lookup: Lookup, axis: int) -> list[tuple[str, str, str]]:
    chosen = lookup.axes[axis]
    name, edges = lookup.names[chosen.variable], list(map(repr, chosen.edges.tolist()))
    return [
        (name, *pair) for pair in zip(["-inf", *edges], [*edges, "inf"], strict=True)
    ]


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
        "tables": [_table(lookup, i) for i in range(len(lookup.tables))],
    }
    return (json.dumps(told, indent=1) + "\n").encode()


def _table(lookup: Lookup, number: int) -> dict:
    table = lookup.tables[number]
    names = [lookup.names[lookup.axes[a].variable] for a in table.axes]
    sizes: Array = np.array(table.values.shape[:-1])
    largest = np.abs(table.values).reshape(-1, len(lookup.joints)).max(axis=0)
    return {
        "table": number,
        "axes": list(table.axes),
        "variables": names,
        "levels": sizes.tolist(),
        "largest": largest.tolist(),
    }
