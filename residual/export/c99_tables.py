"""Tables on top of a model, as C."""

from collections.abc import Iterator

import numpy as np

from residual.export.program import Program
from residual.model.corrected import DIFFERENCE, Column, Tables
from residual.recording import Array

# What the columns of a table are called in the function of the header.
_ARRAYS = {
    "q": "angle",
    "qd": "speed",
    "qdd": "acceleration",
    "sign": "sign_",
    "rigid": "rigid_",
    "tau_model": "total",
}


def tables_of(program: Program) -> Iterator[str]:
    """Return the blocks that add the tables of each joint, in their order."""
    for number, tables in enumerate(program.tables):
        yield _block(tables, number)


def _block(tables: Tables, number: int) -> str:
    lookup, j = tables.lookup, tables.joint
    reads = [*(_read(c) for c in tables.columns), f"out[{j}]"][: len(lookup.names)]
    count = len(reads)
    out = [f"    {{ /* tables on joint {j + 1} */"]
    out.append(_array("x", None, reads))
    out += [_array(n, v) for n, v in (("low", lookup.low), ("high", lookup.high))]
    out.append("        int inside = 1;")
    out.append(
        f"        for (int i = 0; i < {count}; i++)"
        " inside &= low[i] <= x[i] && x[i] <= high[i];"
    )
    out.append(f"        double y = {float(lookup.offset[0])!r};")
    for i in np.flatnonzero(lookup.slope[:, 0]):
        out.append(f"        y += {float(lookup.slope[i, 0])!r} * x[{i}];")
    for k, axis in enumerate(lookup.axes):
        if not any(k in table.axes for table in lookup.tables):
            continue
        name, place = f"edges_{number}_{k}", f"x[{axis.variable}]"
        count = len(axis.edges)
        out.append(_array(name, axis.edges if count else np.zeros(1)))
        out.append(f"        const int l{k} = @P@_level({name}, {count}, {place});")
    for k, table in enumerate(lookup.tables):
        values = table.values[..., 0]
        first, *rest = table.axes
        at = f"l{first} * {values.shape[1]} + l{rest[0]}" if rest else f"l{first}"
        out.append(_array(f"cells_{number}_{k}", values.ravel()))
        out.append(f"        y += cells_{number}_{k}[{at}];")
    return "\n".join([*out, f"        if (inside) out[{j}] += y;", "    }"])


def _read(column: Column) -> str:
    on, of, form = column
    sign = " - " if form == DIFFERENCE else " + "
    return sign.join(f"{_ARRAYS[on]}[{j}]" for j in of)


def _array(name: str, values: Array | None, words: list[str] | None = None) -> str:
    texts = words if values is None else [repr(float(v)) for v in values]
    kind = "const" if values is None else "static const"
    return f"        {kind} double {name}[] = {{{', '.join(texts or ())}}};"
