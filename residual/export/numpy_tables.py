"""Tables on top of a model, for the Python file."""

import io
from collections.abc import Iterator

import numpy as np

from residual.export.program import Program
from residual.model.corrected import DIFFERENCE, NOTHING, Column, Tables
from residual.recording import Array

# What the columns of a table are called in the Python file.
_ARRAYS = {
    "q": "Q",
    "qd": "QD",
    "qdd": "QDD",
    "sign": "SIGN",
    "rigid": "RIGID_",
    "tau_model": "TAU",
}


def store_tables(program: Program) -> dict[str, bytes]:
    """Return the cells of all tables as an NPZ file; nothing where there are none."""
    arrays: dict[str, Array] = {}
    for number, tables in enumerate(program.tables):
        lookup = tables.lookup
        arrays |= {f"low{number}": lookup.low, f"high{number}": lookup.high}
        arrays[f"slope{number}"] = lookup.slope[:, 0]
        for k, axis in enumerate(lookup.axes):
            arrays[f"edges{number}_{k}"] = axis.edges
        for k, table in enumerate(lookup.tables):
            arrays[f"cells{number}_{k}"] = table.values[..., 0]
    if not arrays:
        return {}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return {"torque.npz": buffer.getvalue()}


def tables_of(program: Program) -> Iterator[str]:
    """Return the lines that add the tables of each joint, in their order."""
    known: dict[tuple, str] = {}
    for number, tables in enumerate(program.tables):
        yield from _block(tables, number, known)


def _block(tables: Tables, n: int, known: dict[tuple, str]) -> Iterator[str]:
    lookup, j = tables.lookup, tables.joint
    reads = [*map(_read, tables.columns), f"OUT[{j}]"][: len(lookup.names)]
    yield f"    # tables on joint {j + 1}"
    yield f"    x = [{', '.join(reads)}]"
    if tables.beyond == NOTHING:
        yield f'    low, high = TABLES["low{n}"], TABLES["high{n}"]'
        yield "    inside = np.ones(len(t), bool)"
        yield "    for k, own in enumerate(x):"
        yield "        inside &= (low[k] <= own) & (own <= high[k])"
    yield f"    y = np.full(len(t), {float(lookup.offset[0])!r})"
    for i in np.flatnonzero(lookup.slope[:, 0]):
        yield f"    y += {float(lookup.slope[i, 0])!r} * x[{i}]"
    levels: dict[int, str] = {}
    for k in sorted({k for table in lookup.tables for k in table.axes}):
        axis = lookup.axes[k]
        # Joints often share levels: a search for each of them would cost most.
        key = (reads[axis.variable], axis.edges.tobytes())
        if key not in known:
            known[key] = f"L{len(known)}"
            found = f'np.searchsorted(TABLES["edges{n}_{k}"], x[{axis.variable}]'
            yield f'    {known[key]} = {found}, side="right")'
        levels[k] = known[key]
    for k, table in enumerate(lookup.tables):
        at = ", ".join(levels[axis] for axis in table.axes)
        yield f'    y += TABLES["cells{n}_{k}"][{at}]'
    factor = "inside * " if tables.beyond == NOTHING else ""
    yield f"    OUT[{j}] += {factor}y"


def _read(column: Column) -> str:
    on, of, form = column
    sign = " - " if form == DIFFERENCE else " + "
    return sign.join(f"{_ARRAYS[on]}[{j}]" for j in of)
