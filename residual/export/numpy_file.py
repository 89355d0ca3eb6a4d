"""A model as a Python file that needs NumPy alone, many rows at a time."""

import io
import re
from collections.abc import Iterable, Iterator
from itertools import chain

import numpy as np

from residual.export.exported import Exported, Left, Split, Whole
from residual.export.program import (
    Line,
    Program,
    arrays_of,
    filled,
    program_of,
    split_program,
    template,
)
from residual.model.corrected import DIFFERENCE, NOTHING, Column, Tables
from residual.recording import Array

# What the columns of a table are called in the Python file.
_TABLE_ARRAYS = {
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
        yield from _table_block(tables, number, known)


def _table_block(tables: Tables, n: int, known: dict[tuple, str]) -> Iterator[str]:
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
    return sign.join(f"{_TABLE_ARRAYS[on]}[{j}]" for j in of)


_STEP = 1e-100  # of a complex step: what it squares to is nothing
_NAMES = ("q", "qd", "qdd", "sign", "rigid", "tau")
_NO_FORCE = "(0.0, 0.0, 0.0)"


def to_numpy(whole: Whole) -> Exported:
    """Return a model as torque.py, and its tables, if it has some, as torque.npz."""
    parts = split_program(whole)
    text = source(parts, parts.exported({}).left)
    files = {"torque.py": text.encode()}
    return parts.exported(files | store_tables(program_of(parts.carried)))


def source(parts: Split, left: Iterable[Left] = ()) -> str:
    """Return the text of the file."""
    program = program_of(parts.carried)
    words = {
        "NAME": program.name,
        "DOF": str(program.dof),
        "HAS": ",\n    ".join(program.titles),
        "LEFT": ",\n    ".join(map(str, left)) or "nothing is left out",
        "PATH": "from pathlib import Path\n" if program.tables else "",
    }
    numbers = (
        f"{name.upper()} = {_nested(values)}"
        for name, values in arrays_of(program).items()
    )
    load = ['TABLES = dict(np.load(Path(__file__).with_name("torque.npz")))']
    pieces = [
        template("head.py.txt").rstrip(),
        *numbers,
        *(load if program.tables else ()),
        template("body.py.txt").rstrip(),
        "\n",
        *_torque(program),
        template("tail.py.txt").rstrip(),
    ]
    return filled("\n".join(pieces), words) + "\n"


def _torque(program: Program) -> Iterator[str]:
    yield from (
        "def torque(t, q, qd, qdd):",
        '    """Return the torque of the model [N m]. Shape (n, DOF).',
        "",
        "    Args:",
        "        t: Time since the session began [s]. Shape (n,).",
        "        q, qd, qdd: Motion [rad, rad/s, rad/s^2]. Shapes (n, DOF).",
        '    """',
        "    Q, QD, QDD = (np.array(x, float).T.copy() for x in (q, qd, qdd))",
        f"    RIGID_ = rnea(RIGID, GRAVITY, {_NO_FORCE}, Q, QD, QDD)",
        "    TAU = [1.0 * x for x in RIGID_]",
        "    SIGN = [None] * DOF",
    )
    yield from chain.from_iterable(_sign(program, j) for j in range(program.dof))
    rest = "None, None"
    if program.added is not None:
        yield from _more(f"ADDED, GRAVITY, {_NO_FORCE}, Q, QD, QDD")
    if program.tilt is not None:
        yield from _more(f"LOADED, TILT, {_NO_FORCE}, Q, {rest}")
    if program.force is not None:
        yield from _more(f"np.zeros((DOF, 10)), {_NO_FORCE}, FORCE, Q, {rest}")
    if program.shifts:
        yield from _shifted(program)
    yield from chain.from_iterable(_block(x) for x in program.lines if not x.of_report)
    yield "    OUT = np.stack(TAU)"
    yield from chain.from_iterable(_block(x) for x in program.lines if x.of_report)
    yield from tables_of(program)
    yield "    return OUT.T"


def _more(arguments: str) -> Iterator[str]:
    yield f"    for j, more in enumerate(rnea({arguments})):"
    yield "        TAU[j] += more"


def _sign(program: Program, j: int) -> Iterator[str]:
    """Direction of motion of one joint (``signals.direction``)."""
    shape, floor = program.standstill[j], float(program.floor[j])
    if shape.kind == "smooth":
        text = f"np.tanh(QD[{j}] / {shape.size * floor!r})"
    elif shape.size == 0.0:
        text = f"np.sign(QD[{j}])"
    else:
        text = f"bristle(None, Q[{j}], {float(shape.size)!r})"
    yield f"    SIGN[{j}] = {text}"
    if shape.hold != 1.0:
        slow = f"np.abs(QD[{j}]) < {shape.reach * floor!r}"
        yield f"    SIGN[{j}] *= np.where({slow}, {float(shape.hold)!r}, 1.0)"


def _block(line: Line) -> Iterator[str]:
    """One formula, with the names that it uses and no other."""
    yield f"    # {line.title}"
    names: dict[str, object] = {"a": line.theta.tolist(), "s": list(line.shape)}
    own = [f"{k} = {v}" for k, v in names.items() if k in line.words]
    own += ["m = None"] if "m" in line.words else []
    for name in sorted(line.words & set(_NAMES)):
        array = "RIGID_" if name == "rigid" else name.upper()
        values = [f"{array}[{j}]" for j in line.joints]
        own.append(f"{name} = {values[0] if len(values) == 1 else ', '.join(values)}")
    yield from (f"    {text}" for text in own)
    target = "OUT" if line.of_report else "TAU"
    yield f"    {target}[{line.row}] += {line.formula}"


def _shifted(program: Program) -> Iterator[str]:
    """What lying encoders change: a step along the imaginary axis is a derivative."""
    yield "    SHIFT = np.zeros((3, *Q.shape))"
    for shift in program.shifts:
        words, j = " ".join(shift.formulas), shift.joint
        yield f"    # {shift.title}"
        yield f"    a = {shift.theta.tolist()}"
        for name in ("q", "qd", "qdd"):
            if re.search(rf"\b{name}\b", words):
                yield f"    {name} = {name.upper()}[{j}]"
        for k, text in enumerate(shift.formulas):
            yield f"    SHIFT[{k}, {j}] += {text}"
    yield f"    LIE = [x + {_STEP}j * SHIFT[k] for k, x in enumerate((Q, QD, QDD))]"
    call = f"rnea(LOADED, GRAVITY, {_NO_FORCE}, *LIE)"
    yield f"    for j, more in enumerate({call}):"
    yield f"        TAU[j] += more.imag / {_STEP}"
    yield "        TAU[j] += DRIVE[0][j] * SHIFT[1, j] + DRIVE[1][j] * SHIFT[2, j]"


def _nested(values: np.ndarray) -> str:
    """Numbers with all digits, a row per line."""
    if values.ndim < 2:
        return repr(values.tolist())
    return "[\n" + "".join(f"    {row!r},\n" for row in values.tolist()) + "]"
