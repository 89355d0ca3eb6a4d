"""Tables on top of a model, as C."""

from collections.abc import Iterator

import numpy as np

from residual.export.program import Program
from residual.model.corrected import DIFFERENCE, NOTHING, Column, Tables
from residual.recording import Array

# What the motion is called in the function of the header; and the columns of a table.
MOTION = {
    "q": "angle",
    "qd": "speed",
    "qdd": "acceleration",
    "sign": "sign_",
    "rigid": "rigid_",
}
_ARRAYS = {**MOTION, "tau_model": "total"}


def tables_of(program: Program) -> Iterator[str]:
    """Return the blocks that add the tables of each joint, in their order."""
    known: dict[tuple, str] = {}
    for number, tables in enumerate(program.tables):
        yield from _levels(tables, number, known)
        yield _block(tables, number, known)


def _levels(tables: Tables, number: int, known: dict[tuple, str]) -> Iterator[str]:
    """Places among levels; joints often share them, and a search costs most."""
    for k, axis in enumerate(tables.lookup.axes):
        key = _key(tables, k)
        if key not in known:
            known[key] = f"level_{len(known)}"
            edges = axis.edges if len(axis.edges) else np.zeros(1)
            yield _array(f"edges_{number}_{k}", edges)[4:]
            call = f"@P@_level(edges_{number}_{k}, {len(axis.edges)}, {key[0]})"
            yield f"    const int {known[key]} = {call};"


def _key(tables: Tables, k: int) -> tuple[str, bytes]:
    axis = tables.lookup.axes[k]
    return _reads(tables)[axis.variable], axis.edges.tobytes()


def _block(tables: Tables, number: int, known: dict[tuple, str]) -> str:
    lookup, j = tables.lookup, tables.joint
    reads = _reads(tables)
    out = [f"    {{ /* tables on joint {j + 1} */"]
    out.append(f"        double y = {float(lookup.offset[0])!r};")
    for i in np.flatnonzero(lookup.slope[:, 0]):
        out.append(f"        y += {float(lookup.slope[i, 0])!r} * ({reads[i]});")
    for k, table in enumerate(lookup.tables):
        values = table.values[..., 0]
        first, *rest = (known[_key(tables, axis)] for axis in table.axes)
        at = f"{first} * {values.shape[1]} + {rest[0]}" if rest else first
        out.append(_array(f"cells_{number}_{k}", values.ravel()))
        out.append(f"        y += cells_{number}_{k}[{at}];")
    if tables.beyond == NOTHING:
        out += _inside(tables, reads)
    return "\n".join([*out, f"        out[{j}] += y;", "    }"])


def _inside(tables: Tables, reads: list[str]) -> list[str]:
    """Beyond what it was drawn on such a table says nothing."""
    ends = (("low", tables.lookup.low), ("high", tables.lookup.high))
    return [
        _array("x", None, reads),
        *(_array(name, values) for name, values in ends),
        f"        for (int i = 0; i < {len(reads)}; i++)"
        " if (x[i] < low[i] || x[i] > high[i]) y = 0.0;",
    ]


def _reads(tables: Tables) -> list[str]:
    own = [*map(_read, tables.columns), f"out[{tables.joint}]"]
    return own[: len(tables.lookup.names)]


def _read(column: Column) -> str:
    on, of, form = column
    sign = " - " if form == DIFFERENCE else " + "
    return sign.join(f"{_ARRAYS[on]}[{j}]" for j in of)


def _array(name: str, values: Array | None, words: list[str] | None = None) -> str:
    texts = words if values is None else [repr(float(v)) for v in values]
    kind = "const" if values is None else "static const"
    return f"        {kind} double {name}[] = {{{', '.join(texts or ())}}};"
