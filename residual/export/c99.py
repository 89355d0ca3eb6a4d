"""A model as one C99 header without allocation: rigid body, named effects, tables."""

import re
from collections.abc import Collection, Iterable, Iterator

import numpy as np

from residual.export.exported import Exported, Left, Split, Whole, file_stem
from residual.export.program import (
    WORD,
    Line,
    Program,
    Shift,
    arrays_of,
    filled,
    program_of,
    reads_of,
    split_program,
    template,
)
from residual.model.corrected import NOTHING, Tables
from residual.model.lookup import Lookup
from residual.signals.standstill import Standstill

# What a formula or a table calls the motion, and what the function of the header does.
_ARRAYS = {
    "q": "angle",
    "qd": "speed",
    "qdd": "acceleration",
    "sign": "sign_",
    "rigid": "rigid_",
    "tau": "total",
    "tau_model": "total",
}
_OWN = ("sgn", "bristle", "earlier")  # functions that the header brings itself
_STEP = "1e-100"  # of a complex step: what it squares to is nothing
_HEAD = """\
static inline void @P@_torque(
    @P@_memory *memory, double t, const double *angle,
    const double *speed, const double *acceleration, double *out)
{"""


def to_c99(whole: Whole) -> Exported:
    """Return a model as a header; its functions begin with the robot's name."""
    parts = split_program(whole)
    found = parts.exported({})
    name = f"{prefix_of(file_stem(whole))}.h"
    return parts.exported({name: header(parts, found.left).encode()})


def tables_header(lookup: Lookup, robot: str) -> dict[str, bytes]:
    """Return tables without a model as a header, by file name: x in, correction out.

    Of the paper's tables, which correct the torque of a simulated twin.
    """
    prefix = f"{prefix_of(robot)}_tables"
    start, end = "/* Place of x among", "static inline void @P@_cross"
    level = template("helpers.h").split(start)[1].split(end)[0]
    words = {
        "P": prefix,
        "GUARD": f"{prefix.upper()}_H",
        "NAME": robot,
        "X": _wrapped(f"{i} {name}" for i, name in enumerate(lookup.names)),
        "OUT": _wrapped(f"{i} {name}" for i, name in enumerate(lookup.joints)),
        "LEVEL": f"{start}{level.rstrip()}",
        "BODY": "\n".join(f"    {line}" for line in _correction(lookup)),
    }
    # Names of variables and robots come from outside: they are filled in last.
    order = ("LEVEL", "BODY", "P", "GUARD", "X", "OUT", "NAME")
    text = filled(template("tables.h"), {name: words[name] for name in order})
    return {f"{prefix}.h": (text.rstrip() + "\n").encode()}


def _correction(lookup: Lookup) -> Iterator[str]:
    """What a header of tables alone does, a line each."""
    count = len(lookup.joints)
    yield _constant("middle", lookup.offset)
    yield f"for (int j = 0; j < {count}; j++) out[j] = middle[j];"
    if lookup.slope.any():
        yield _constant("slope", lookup.slope.ravel())
        inner = f"for (int j = 0; j < {count}; j++) out[j] += slope[{count} * i + j]"
        yield f"for (int i = 0; i < {len(lookup.names)}; i++)"
        yield f"    {inner} * x[i];"
    for k, axis in enumerate(lookup.axes):
        yield _constant(f"edges_{k}", axis.edges if len(axis.edges) else [0.0])
        call = f"@P@_level(edges_{k}, {len(axis.edges)}, x[{axis.variable}])"
        yield f"const int level_{k} = {call};"
        yield f"(void)level_{k};"
    for k, table in enumerate(lookup.tables):
        first, *rest = (f"level_{axis}" for axis in table.axes)
        place = f"({first} * {table.values.shape[1]} + {rest[0]})" if rest else first
        yield _constant(f"cells_{k}", table.values.ravel())
        yield (
            f"for (int j = 0; j < {count}; j++) "
            f"out[j] += cells_{k}[{count} * {place} + j];"
        )


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
        *([_complex()] if program.shifts else ()),
        *_torque(program),
        "\n#endif",
    ]
    return filled("\n".join(pieces), words) + "\n"


def _complex() -> str:
    """The same for complex numbers: their imaginary part carries a derivative."""
    real = "double complex"
    named = {"REAL": real, "BODY": "change", "COS": "ccos", "SIN": "csin"}
    cross = template("helpers.h").split("static inline void @P@_cross")[1]
    cross = "static inline void @P@_ccross" + cross.replace("double", real)
    return f"{cross}\n{filled(template('body.h'), named | {'CROSS': '@P@_ccross'})}"


def _numbers(program: Program) -> Iterator[str]:
    for name, values in arrays_of(program).items():
        flat = values.reshape(-1, 9) if values.ndim == 3 else values
        size = "".join(f"[{n}]" for n in flat.shape)
        yield f"static const double @P@_{name}{size} = {_list(flat)};"
    yield ""


def _torque(program: Program) -> Iterator[str]:
    p, dof = "@P@", program.dof
    yield _HEAD
    yield f"    double rigid_[{dof}], sign_[{dof}], total[{dof}], part[{dof}];"
    yield "    (void)memory, (void)t, (void)part;"
    motion = "angle, speed, acceleration"
    yield f"    {p}_body({p}_rigid, {p}_gravity, 0, {motion}, rigid_);"
    yield _each(dof, "total[i] = rigid_[i];")
    yield from (_sign(program, j) for j in range(dof))
    if program.added is not None:
        yield _part(dof, f"{p}_added, {p}_gravity, 0, {motion}")
    if program.tilt is not None:
        yield f"    static const double at_rest[{dof}] = {{0.0}};"
        yield _part(dof, f"{p}_loaded, {p}_tilt, 0, angle, at_rest, at_rest")
    if program.force is not None:
        yield f"    static const double no_body[{dof}][10] = {{{{0.0}}}};"
        yield f"    static const double no_gravity[3], unmoved[{dof}] = {{0.0}};"
        yield _part(dof, f"no_body, no_gravity, {p}_force, angle, unmoved, unmoved")
    if program.shifts:
        yield from _shifted(program)
    yield from (_block(line) for line in program.lines if not line.of_report)
    yield _each(dof, "out[i] = total[i];")
    yield from (_block(line) for line in program.lines if line.of_report)
    yield from _tables(program)
    yield "}"


def _each(dof: int, text: str) -> str:
    return f"    for (int i = 0; i < {dof}; i++) {text}"


def _part(dof: int, arguments: str) -> str:
    total = _each(dof, "total[i] += part[i];")
    return f"    @P@_body({arguments}, part);\n{total}"


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
    own = []
    if "a" in line.words:
        own.append(f"static const double a[] = {_list(line.theta)};")
    if "s" in line.words:
        own.append(f"static const double s[] = {_list(line.shape)};")
    if "m" in line.words:
        own.append(f"double *m = memory->number + {line.memory};")
    formula = re.sub(rf"\b({'|'.join(_OWN)})\(", r"@P@_\1(", line.formula)
    target = "out" if line.of_report else "total"
    own += [*_names(line.words, line.joints), f"{target}[{line.row}] += {formula};"]
    return _braces(line.title, own)


def _shift(shift: Shift) -> str:
    words = set(WORD.findall(" ".join(shift.formulas)))
    rows = enumerate(shift.formulas)
    own = [
        f"static const double a[] = {_list(shift.theta)};",
        *_names(words & {"q", "qd", "qdd"}, (shift.joint,)),
        *(f"shift[{k}][{shift.joint}] += {text};" for k, text in rows),
    ]
    return _braces(shift.title, own)


def _names(words: Collection[str], joints: Collection[int]) -> Iterator[str]:
    for name in sorted(set(words) & {*_ARRAYS} - {"tau_model"}):
        first, *more = (f"{_ARRAYS[name]}[{j}]" for j in joints)
        pair = f"{name}[] = {{{', '.join([first, *more])}}}"
        yield f"const double {pair if more else f'{name} = {first}'};"


def _braces(title: str, lines: Iterable[str]) -> str:
    inner = (f"        {line}" for line in lines)
    return "\n".join([f"    {{ /* {title} */", *inner, "    }"])


def _shifted(program: Program) -> Iterator[str]:
    """What lying encoders change: a step along the imaginary axis is a derivative."""
    dof = program.dof
    yield f"    double shift[3][{dof}] = {{{{0.0}}}};"
    yield from map(_shift, program.shifts)
    yield f"    double complex x[3][{dof}], change[{dof}];"
    rows = (
        f"x[{k}][i] = {name}[i] + {_STEP} * I * shift[{k}][i];"
        for k, name in enumerate(("angle", "speed", "acceleration"))
    )
    yield _each(dof, "{\n        " + "\n        ".join(rows) + "\n    }")
    yield "    @P@_change(@P@_loaded, @P@_gravity, 0, x[0], x[1], x[2], change);"
    drive = "@P@_drive[0][i] * shift[1][i] + @P@_drive[1][i] * shift[2][i]"
    yield _each(dof, f"total[i] += cimag(change[i]) / {_STEP} + {drive};")


def _tables(program: Program) -> Iterator[str]:
    """The blocks that add the tables of each joint, in their order."""
    known: dict[tuple, str] = {}
    for number, tables in enumerate(program.tables):
        reads = reads_of(tables, _ARRAYS, "out")
        levels = []
        for k, axis in enumerate(tables.lookup.axes):
            # Joints often share places among levels, and a search costs most.
            key = reads[axis.variable], axis.edges.tobytes()
            if key not in known:
                known[key] = f"level_{len(known)}"
                edges = axis.edges if len(axis.edges) else [0.0]
                yield f"    {_constant(f'edges_{number}_{k}', edges)}"
                call = f"@P@_level(edges_{number}_{k}, {len(axis.edges)}, {key[0]})"
                yield f"    const int {known[key]} = {call};"
            levels.append(known[key])
        block = _table_block(tables, number, reads, levels)
        yield _braces(f"tables on joint {tables.joint + 1}", block)


def _table_block(
    tables: Tables, number: int, reads: list[str], levels: list[str]
) -> Iterator[str]:
    lookup = tables.lookup
    yield f"double y = {float(lookup.offset[0])!r};"
    for i in np.flatnonzero(lookup.slope[:, 0]):
        yield f"y += {float(lookup.slope[i, 0])!r} * ({reads[i]});"
    for k, table in enumerate(lookup.tables):
        values = table.values[..., 0]
        first, *rest = (levels[axis] for axis in table.axes)
        at = f"{first} * {values.shape[1]} + {rest[0]}" if rest else first
        yield _constant(f"cells_{number}_{k}", values.ravel())
        yield f"y += cells_{number}_{k}[{at}];"
    if tables.beyond == NOTHING:
        # Beyond what it was drawn on such a table says nothing.
        yield f"const double x[] = {{{', '.join(reads)}}};"
        yield _constant("low", lookup.low)
        yield _constant("high", lookup.high)
        yield (
            f"for (int i = 0; i < {len(reads)}; i++)"
            " if (x[i] < low[i] || x[i] > high[i]) y = 0.0;"
        )
    yield f"out[{tables.joint}] += y;"


def _constant(name: str, values: Iterable) -> str:
    return f"static const double {name}[] = {_list(list(values))};"


def _list(values) -> str:
    if np.ndim(values) == 0:
        return repr(float(values))
    inner = ",\n    " if np.ndim(values) > 1 else ", "
    return "{" + inner.join(_list(v) for v in values) + "}"


def _wrapped(parts: Iterable[str]) -> str:
    return ",\n     ".join(parts).replace("*/", "")
