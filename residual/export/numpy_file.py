"""A model as a Python file that needs NumPy alone, many rows at a time."""

import io
from collections.abc import Collection, Iterable, Iterator

import numpy as np

from residual.export.exported import Exported, Left, Split, Whole
from residual.export.program import (
    WORD,
    Program,
    arrays_of,
    filled,
    program_of,
    reads_of,
    split_program,
    template,
)
from residual.model.corrected import NOTHING, Tables
from residual.recording import Array

# What a formula, or a table, calls the motion, and what the function of the file does.
_ARRAYS = {
    "q": "Q",
    "qd": "QD",
    "qdd": "QDD",
    "sign": "SIGN",
    "rigid": "RIGID_",
    "tau": "TAU",
    "tau_model": "TAU",
}
_STEP = 1e-100  # of a complex step: what it squares to is nothing
_NO_FORCE = "(0.0, 0.0, 0.0)"
_HEAD = f'''\
def torque(t, q, qd, qdd):
    """Return the torque of the model [N m]. Shape (n, DOF).

    Args:
        t: Time since the session began [s]. Shape (n,).
        q, qd, qdd: Motion [rad, rad/s, rad/s^2]. Shapes (n, DOF).
    """
    Q, QD, QDD = (np.array(x, float).T.copy() for x in (q, qd, qdd))
    RIGID_ = rnea(RIGID, GRAVITY, {_NO_FORCE}, Q, QD, QDD)
    TAU = [1.0 * x for x in RIGID_]
    SIGN = [None] * DOF'''
_ROW = '''\
def torque_row(t, q, qd, qdd):
    """Return the torque of the model at one row [N m]. Shape (DOF,).

    Args:
        t: Time since the session began [s].
        q, qd, qdd: Motion [rad, rad/s, rad/s^2]. Shapes (DOF,).
    """'''
_ROW_HEAD = """\
Q, QD, QDD = (np.asarray(x, float).tolist() for x in (q, qd, qdd))
RIGID_ = RIGID_ROW(Q, QD, QDD)
TAU = list(RIGID_)
SIGN = [None] * DOF"""


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
        _HEAD,
        *(f"    {line}" for line in _torque(program)),
        "\n",
        *_row(program),
        template("tail.py.txt").rstrip(),
    ]
    return filled("\n".join(pieces), words) + "\n"


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


def _torque(program: Program) -> Iterator[str]:
    for j in range(program.dof):
        yield from _sign(program, j)
    if program.added is not None:
        yield from _more(f"ADDED, GRAVITY, {_NO_FORCE}, Q, QD, QDD")
    if program.tilt is not None:
        yield from _more(f"LOADED, TILT, {_NO_FORCE}, Q, None, None")
    if program.force is not None:
        yield from _more(f"np.zeros((DOF, 10)), {_NO_FORCE}, FORCE, Q, None, None")
    if program.shifts:
        yield from _shifted(program)
    yield from _blocks(program, of_report=False)
    yield "OUT = np.stack(TAU)"
    yield from _blocks(program, of_report=True)
    known: dict[tuple, str] = {}
    for number, tables in enumerate(program.tables):
        yield from _table_block(tables, number, known)
    yield "return OUT.T"


def _more(arguments: str, call: str = "rnea") -> Iterator[str]:
    yield f"for j, more in enumerate({call}({arguments})):"
    yield "    TAU[j] += more"


def _row(program: Program) -> Iterator[str]:
    """A function of a single row: plain numbers, and a recursion without loops."""
    if program.memory or program.shifts:
        # What remembers earlier rows, or needs complex numbers, is as it is for many.
        yield _ROW
        yield "    return torque(np.array([t]), [q], [qd], [qdd])[0]"
        return
    made = {"RIGID_ROW": f"RIGID, GRAVITY, {_NO_FORCE}"}
    if program.added is not None:
        made["ADDED_ROW"] = f"ADDED, GRAVITY, {_NO_FORCE}"
    if program.tilt is not None:
        made["TILT_ROW"] = f"LOADED, TILT, {_NO_FORCE}, True"
    if program.force is not None:
        made["FORCE_ROW"] = f"[[0.0] * 10] * DOF, {_NO_FORCE}, FORCE, True"
    yield from (f"{name} = straight({words})" for name, words in made.items())
    if program.tables:
        yield "PLAIN = {name: values.tolist() for name, values in TABLES.items()}"
    yield f"\n\n{_ROW}"
    yield from (f"    {line}" for line in _row_torque(program, [*made][1:]))


def _row_torque(program: Program, more: Iterable[str]) -> Iterator[str]:
    yield from _ROW_HEAD.splitlines()
    for j in range(program.dof):
        yield from _sign(program, j)
    for name in more:
        yield from _more("Q, QD, QDD", name)
    yield from _blocks(program, of_report=False)
    yield "OUT = list(TAU)"
    yield from _blocks(program, of_report=True)
    known: dict[tuple, str] = {}
    for number, tables in enumerate(program.tables):
        yield from _table_block(tables, number, known, row=True)
    yield "return np.array(OUT)"


def _sign(program: Program, j: int) -> Iterator[str]:
    """Direction of motion of one joint (``signals.direction``)."""
    shape, floor = program.standstill[j], float(program.floor[j])
    if shape.kind == "smooth":
        text = f"np.tanh(QD[{j}] / {shape.size * floor!r})"
    elif shape.size == 0.0:
        text = f"np.sign(QD[{j}])"
    else:
        text = f"bristle(None, Q[{j}], {float(shape.size)!r})"
    yield f"SIGN[{j}] = {text}"
    if shape.hold != 1.0:
        slow = f"np.abs(QD[{j}]) < {shape.reach * floor!r}"
        yield f"SIGN[{j}] *= np.where({slow}, {float(shape.hold)!r}, 1.0)"


def _blocks(program: Program, of_report: bool) -> Iterator[str]:
    """Every formula, with the names that it uses and no other."""
    for line in (line for line in program.lines if line.of_report == of_report):
        yield f"# {line.title}"
        if "a" in line.words:
            yield f"a = {line.theta.tolist()}"
        if "s" in line.words:
            yield f"s = {list(line.shape)}"
        if "m" in line.words:
            yield "m = None"
        yield from _names(line.words, line.joints)
        yield f"{'OUT' if of_report else 'TAU'}[{line.row}] += {line.formula}"


def _names(words: Collection[str], joints: Collection[int]) -> Iterator[str]:
    for name in sorted(set(words) & {*_ARRAYS} - {"tau_model"}):
        yield f"{name} = {', '.join(f'{_ARRAYS[name]}[{j}]' for j in joints)}"


def _shifted(program: Program) -> Iterator[str]:
    """What lying encoders change: a step along the imaginary axis is a derivative."""
    yield "SHIFT = np.zeros((3, *Q.shape))"
    for shift in program.shifts:
        yield f"# {shift.title}"
        yield f"a = {shift.theta.tolist()}"
        words = set(WORD.findall(" ".join(shift.formulas)))
        yield from _names(words & {"q", "qd", "qdd"}, (shift.joint,))
        for k, text in enumerate(shift.formulas):
            yield f"SHIFT[{k}, {shift.joint}] += {text}"
    yield f"LIE = [x + {_STEP}j * SHIFT[k] for k, x in enumerate((Q, QD, QDD))]"
    yield f"for j, more in enumerate(rnea(LOADED, GRAVITY, {_NO_FORCE}, *LIE)):"
    yield f"    TAU[j] += more.imag / {_STEP}"
    yield "    TAU[j] += DRIVE[0][j] * SHIFT[1, j] + DRIVE[1][j] * SHIFT[2, j]"


def _table_block(
    tables: Tables, n: int, known: dict[tuple, str], row: bool = False
) -> Iterator[str]:
    """The lines that add the tables of a joint, of many rows or of a single one."""
    lookup, j = tables.lookup, tables.joint
    reads, kept = reads_of(tables, _ARRAYS, "OUT"), "PLAIN" if row else "TABLES"
    yield f"# tables on joint {j + 1}"
    yield f"x = [{', '.join(reads)}]"
    if tables.beyond == NOTHING:
        yield f'low, high = {kept}["low{n}"], {kept}["high{n}"]'
        yield f"inside = {'True' if row else 'np.ones(len(t), bool)'}"
        yield "for k, own in enumerate(x):"
        yield "    inside &= (low[k] <= own) & (own <= high[k])"
    offset = float(lookup.offset[0])
    yield f"y = {offset!r}" if row else f"y = np.full(len(t), {offset!r})"
    for i in np.flatnonzero(lookup.slope[:, 0]):
        yield f"y += {float(lookup.slope[i, 0])!r} * x[{i}]"
    levels: dict[int, str] = {}
    for k in sorted({k for table in lookup.tables for k in table.axes}):
        axis = lookup.axes[k]
        # Joints often share levels: a search for each of them would cost most.
        key = (reads[axis.variable], axis.edges.tobytes())
        if key not in known:
            known[key] = f"L{len(known)}"
            places = f'({kept}["edges{n}_{k}"], x[{axis.variable}]'
            search = f"bisect_right{places})"
            many = f'np.searchsorted{places}, side="right")'
            yield f"{known[key]} = {search if row else many}"
        levels[k] = known[key]
    for k, table in enumerate(lookup.tables):
        at = ("][" if row else ", ").join(levels[axis] for axis in table.axes)
        yield f'y += {kept}["cells{n}_{k}"][{at}]'
    factor = "inside * " if tables.beyond == NOTHING else ""
    yield f"OUT[{j}] += {factor}y"


def _nested(values: np.ndarray) -> str:
    """Numbers with all digits, a row per line."""
    if values.ndim < 2:
        return repr(values.tolist())
    return "[\n" + "".join(f"    {row!r},\n" for row in values.tolist()) + "]"
