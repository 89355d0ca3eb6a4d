"""A model as one C99 header without allocation: rigid body, named effects, tables."""

import re
from collections.abc import Iterable, Iterator

import numpy as np

from residual.export.exported import Exported, Left, Split, Whole, file_stem
from residual.export.program import (
    Line,
    Program,
    Shift,
    arrays_of,
    filled,
    program_of,
    split_program,
    template,
)
from residual.model.corrected import DIFFERENCE, NOTHING, Column, Tables
from residual.recording import Array
from residual.signals.direction import Standstill

# What the motion is called in the function of the header; and the columns of a table.
MOTION = {
    "q": "angle",
    "qd": "speed",
    "qdd": "acceleration",
    "sign": "sign_",
    "rigid": "rigid_",
}
_TABLE_ARRAYS = {**MOTION, "tau_model": "total"}


def tables_of(program: Program) -> Iterator[str]:
    """Return the blocks that add the tables of each joint, in their order."""
    known: dict[tuple, str] = {}
    for number, tables in enumerate(program.tables):
        yield from _levels(tables, number, known)
        yield _table_block(tables, number, known)


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


def _table_block(tables: Tables, number: int, known: dict[tuple, str]) -> str:
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
    return sign.join(f"{_TABLE_ARRAYS[on]}[{j}]" for j in of)


def _array(name: str, values: Array | None, words: list[str] | None = None) -> str:
    texts = words if values is None else [repr(float(v)) for v in values]
    kind = "const" if values is None else "static const"
    return f"        {kind} double {name}[] = {{{', '.join(texts or ())}}};"


# What a formula calls the motion, and what the function of the header calls it.
_ARRAYS = {**MOTION, "tau": "total"}
_OWN = ("sgn", "bristle", "earlier")  # functions that the header brings itself
_STEP = "1e-100"  # of a complex step: what it squares to is nothing
_HEAD = "static inline void {p}_torque(\n    {p}_memory *memory, double t, const"
_ARGUMENTS = " double *angle,\n    const double *speed, const double *acceleration,"


def to_c99(whole: Whole) -> Exported:
    """Return a model as a header; its functions begin with the robot's name."""
    parts = split_program(whole)
    found = parts.exported({})
    text = header(parts, found.left)
    name = f"{prefix_of(file_stem(whole))}.h"
    return parts.exported({name: text.encode()})


def prefix_of(name: str) -> str:
    """Return the name of a robot as C can have it."""
    word = re.sub(r"\W", "_", name)
    return word if word[0].isalpha() else f"arm_{word}"


def header(parts: Split, left: Iterable[Left] = ()) -> str:
    """Return the text of the header."""
    program = program_of(parts.carried)
    words = {
        "NAME": program.name,
        "GUARD": f"{prefix_of(program.name).upper()}_H",
        "HAS": _wrapped(program.titles),
        "LEFT": _wrapped([str(each) for each in left] or ["nothing is left out"]),
        "MEMORY": str(max(program.memory, 1)),
        "COMPLEX": "#include <complex.h>\n" if program.shifts else "",
        "P": prefix_of(program.name),
        "DOF": str(program.dof),
    }
    real = {"REAL": "double", "BODY": "body", "COS": "cos", "SIN": "sin"}
    pieces = [
        template("head.h"),
        *_numbers(program),
        template("helpers.h"),
        filled(template("body.h"), real | {"CROSS": "@P@_cross"}),
    ]
    if program.shifts:
        pieces.append(_complex())
    pieces += [*_torque(program), "\n#endif"]
    return filled("\n".join(pieces), words) + "\n"


def _complex() -> str:
    """The same for complex numbers: their imaginary part carries a derivative."""
    real = "double complex"
    named = {"REAL": real, "BODY": "change", "COS": "ccos", "SIN": "csin"}
    cross = template("helpers.h").split("static inline void @P@_cross")[1]
    cross = "static inline void @P@_ccross" + cross.replace("double", real)
    return f"{cross}\n{filled(template('body.h'), named | {'CROSS': '@P@_ccross'})}"


def _torque(program: Program) -> Iterator[str]:
    p, dof = "@P@", program.dof
    yield _HEAD.format(p=p) + _ARGUMENTS + " double *out)\n{"
    yield f"    double rigid_[{dof}], sign_[{dof}], total[{dof}], part[{dof}];"
    yield "    (void)memory, (void)t, (void)part;"
    motion = "angle, speed, acceleration"
    yield f"    {p}_body({p}_rigid, {p}_gravity, 0, {motion}, rigid_);"
    yield _each(dof, "total[i] = rigid_[i];")
    yield from (_sign(program, j) for j in range(dof))
    if program.added is not None:
        yield _part(dof, f"{p}_body({p}_added, {p}_gravity, 0, {motion}, part);")
    if program.tilt is not None:
        still = "at_rest, at_rest, part);"
        yield f"    static const double at_rest[{dof}] = {{0.0}};"
        yield _part(dof, f"{p}_body({p}_loaded, {p}_tilt, 0, angle, {still}")
    if program.force is not None:
        none = "no_gravity, @P@_force, angle, unmoved, unmoved, part);"
        yield f"    static const double no_body[{dof}][10] = {{{{0.0}}}};"
        yield f"    static const double no_gravity[3], unmoved[{dof}] = {{0.0}};"
        yield _part(dof, f"{p}_body(no_body, {none}")
    if program.shifts:
        yield from _shifted(program)
    yield from map(_block, (x for x in program.lines if not x.of_report))
    yield _each(dof, "out[i] = total[i];")
    yield from map(_block, (x for x in program.lines if x.of_report))
    yield from tables_of(program)
    yield "}"


def _each(dof: int, text: str) -> str:
    return f"    for (int i = 0; i < {dof}; i++) {text}"


def _part(dof: int, text: str) -> str:
    return f"    {text}\n{_each(dof, 'total[i] += part[i];')}"


def _sign(program: Program, j: int) -> str:
    """Direction of motion of one joint (``signals.direction``)."""
    shape: Standstill = program.standstill[j]
    floor = float(program.floor[j])
    if shape.kind == "smooth":
        text = f"tanh(speed[{j}] / {shape.size * floor!r})"
    elif shape.size == 0.0:
        text = f"@P@_sgn(speed[{j}])"
    else:
        place = f"memory->number + {program.bristles[j]}"
        text = f"@P@_bristle({place}, angle[{j}], {float(shape.size)!r})"
    out = f"    sign_[{j}] = {text};"
    if shape.hold == 1.0:
        return out
    slow = f"fabs(speed[{j}]) < {shape.reach * floor!r}"
    return f"{out}\n    if ({slow}) sign_[{j}] *= {float(shape.hold)!r};"


def _block(line: Line) -> str:
    """One formula, with the names that it uses and no other."""
    own = [f"    {{ /* {line.title} */"]
    arrays = dict(_ARRAYS)
    if "a" in line.words:
        own.append(f"        static const double a[] = {_list(line.theta)};")
    if "s" in line.words:
        own.append(f"        static const double s[] = {_list(line.shape)};")
    if "m" in line.words:
        own.append(f"        double *m = memory->number + {line.memory};")
    for name in sorted(line.words & set(arrays)):
        values = [f"{arrays[name]}[{j}]" for j in line.joints]
        pair = f"{name}[] = {{{', '.join(values)}}}"
        text = pair if len(values) > 1 else f"{name} = {values[0]}"
        own.append(f"        const double {text};")
    target = "out" if line.of_report else "total"
    own.append(f"        {target}[{line.row}] += {_called(line.formula)};\n    }}")
    return "\n".join(own)


def _shifted(program: Program) -> Iterator[str]:
    """What lying encoders change: a step along the imaginary axis is a derivative."""
    dof = program.dof
    names = ("angle", "speed", "acceleration")
    yield f"    double shift[3][{dof}] = {{{{0.0}}}};"
    yield from map(_shift, program.shifts)
    yield f"    double complex x[3][{dof}], change[{dof}];"
    rows = (
        f"x[{k}][i] = {name}[i] + {_STEP} * I * shift[{k}][i];"
        for k, name in enumerate(names)
    )
    yield _each(dof, "{\n        " + "\n        ".join(rows) + "\n    }")
    yield "    @P@_change(@P@_loaded, @P@_gravity, 0, x[0], x[1], x[2], change);"
    drive = "@P@_drive[0][i] * shift[1][i] + @P@_drive[1][i] * shift[2][i]"
    yield _each(dof, f"total[i] += cimag(change[i]) / {_STEP} + {drive};")


def _shift(shift: Shift) -> str:
    words = re.findall(r"[a-z]\w*", " ".join(shift.formulas))
    own = [f"    {{ /* {shift.title} */"]
    own.append(f"        static const double a[] = {_list(shift.theta)};")
    own += [
        f"        const double {name} = {_ARRAYS[name]}[{shift.joint}];"
        for name in ("q", "qd", "qdd")
        if name in words
    ]
    own += [
        f"        shift[{k}][{shift.joint}] += {text};"
        for k, text in enumerate(shift.formulas)
    ]
    return "\n".join([*own, "    }"])


def _called(formula: str) -> str:
    return re.sub(rf"\b({'|'.join(_OWN)})\(", r"@P@_\1(", formula)


def _numbers(program: Program) -> Iterator[str]:
    """The numbers of the model."""
    for name, values in arrays_of(program).items():
        flat = values.reshape(-1, 9) if values.ndim == 3 else values
        size = "".join(f"[{n}]" for n in flat.shape)
        yield f"static const double @P@_{name}{size} = {_list(flat)};"
    yield ""


def _list(values) -> str:
    if np.ndim(values) == 0:
        return repr(float(values))
    inner = ",\n    " if np.ndim(values) > 1 else ", "
    return "{" + inner.join(_list(v) for v in values) + "}"


def _wrapped(parts: Iterable[str]) -> str:
    return ",\n     ".join(parts).replace("*/", "")
