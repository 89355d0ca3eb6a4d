"""A model for controllers: as one C99 header without allocation, or as support points.

The header has rigid body, named effects and tables.
"""

import csv
import io
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib import resources

import numpy as np

from residual.effects.base import BRISTLE, EffectTrait
from residual.export.model_export import (
    AnyModel,
    ModelExport,
    OmittedTerm,
    build_reference_motion,
    fill_joint_limits,
    make_file_stem,
    measure_torque_difference,
    remove_tables,
    split_exportable_terms,
)
from residual.model.lookup import (
    DIFFERENCE,
    NONE,
    NOTHING,
    CorrectedModel,
    JointCorrection,
    build_lookup_files,
)
from residual.model.model import LEAST_SPEED, Model, Term
from residual.quantity import convert_to_sliding_unit
from residual.recording import Array
from residual.robot.dynamics import build_kinematic_chain
from residual.robot.robot import refuse_carried_weight
from residual.signals.track import SMOOTH

WORD = re.compile(r"[a-z]\w*")
# Names of the signals in formulas and tables, and in the C function.
_ARRAYS = {
    "q": "angle",
    "qd": "speed",
    "qdd": "acceleration",
    "sign": "sign_",
    "rigid": "rigid_",
    "tau": "total",
    "tau_model": "total",
}
_STEP = "1e-100"  # size of a complex step: its square underflows
_HEAD = """\
static inline void @P@_torque(
    @P@_memory *memory, double t, const double *angle,
    const double *speed, const double *acceleration, double *out)
{"""


def to_c99(source: AnyModel) -> ModelExport:
    """Return a model as a header; its functions begin with the robot's name."""
    refuse_carried_weight(remove_tables(source).robot, "a C header")
    made = split_exportable_terms(source, explain_missing_formula)
    text, _ = write_c_header(made.carried, made.omissions)
    return replace(made, files={f"{make_c_identifier(make_file_stem(source))}.h": text.encode()})


def explain_missing_formula(term: Term) -> str:
    """Return why a program cannot compute a term sample by sample; "" if it can."""
    form = term.effect.portable
    ways = (form.formula, form.shift, form.bodies, form.gravity, form.force)
    if any(ways) and form.possible(term.theta, term.shape):
        return ""
    return form.obstacle or "no formula says it"


def make_c_identifier(name: str) -> str:
    """Return the name of a robot as a C identifier."""
    word = re.sub(r"\W", "_", name)
    return word if word[0].isalpha() else f"arm_{word}"


def write_c_header(
    exported_model: AnyModel, omissions: Iterable[OmittedTerm] = ()
) -> tuple[str, int]:
    """Return the text of the header, and the size of its memory."""
    model, stem = remove_tables(exported_model), make_file_stem(exported_model)
    tables = exported_model.tables if isinstance(exported_model, CorrectedModel) else ()
    tables = tuple(t for t in tables if t.kind != NONE)
    shifts = [t for t in model.terms if t.effect.portable.shift]
    arrays = _arrays(model, bool(shifts))
    torque, memory = _torque(model, arrays, shifts, tables)
    titles = ["the rigid body", *dict.fromkeys(map(_title, model.terms))]
    titles += [f"tables on joint {t.joint + 1}" for t in tables]
    words = {
        "NAME": stem,
        "GUARD": f"{make_c_identifier(stem).upper()}_H",
        "HAS": _comment(titles),
        "LEFT": _comment([str(each) for each in omissions] or ["nothing is left out"]),
        "MEMORY": str(max(memory, 1)),
        "COMPLEX": "#include <complex.h>\n" if shifts else "",
        "P": make_c_identifier(stem),
        "DOF": str(model.robot.dof),
    }
    body = {"REAL": "double", "BODY": "body", "COS": "cos", "SIN": "sin"}
    pieces = [read_template("head.h")]
    for name, values in arrays.items():
        flat = values.reshape(-1, 9) if values.ndim == 3 else values
        size = "".join(f"[{n}]" for n in flat.shape)
        pieces.append(f"static const double @P@_{name}{size} = {_list(flat)};")
    helpers = read_template("helpers.h")
    pieces += ["", helpers, fill_template(read_template("body.h"), body | {"CROSS": "@P@_cross"})]
    if shifts:
        # The same for complex numbers: their imaginary part carries a derivative.
        real, start = "double complex", "static inline void @P@_"
        cross = helpers.split(f"{start}cross")[1].replace("double", real)
        body = {"REAL": real, "BODY": "change", "COS": "ccos", "SIN": "csin"}
        pieces.append(f"{start}ccross{cross}")
        pieces.append(fill_template(read_template("body.h"), body | {"CROSS": "@P@_ccross"}))
    text = "\n".join([*pieces, *torque, "\n#endif"])
    return fill_template(text, words) + "\n", memory


def _title(term: Term) -> str:
    on = " and ".join(str(j + 1) for j in term.joints)
    return f"{term.effect.name} on joint {on}" if on else term.effect.name


def _arrays(model: Model, shifted: bool) -> dict[str, Array]:
    """The constants of a header: R(q) = still + cos(q) along + sin(q) across."""
    chain, dof = build_kinematic_chain(model.robot.model), model.robot.dof
    turns = ~chain.slides[:, None, None]
    onto = np.where(turns, np.einsum("ij,ik->ijk", chain.axis, chain.axis), np.eye(3))
    skew = np.cross(np.eye(3)[None], chain.axis[:, None, :]) * turns
    arrays = {
        "place": chain.place,
        "axis": chain.axis * turns[:, 0],
        "slide": chain.axis * chain.slides[:, None],
        "still": chain.rotation @ onto,
        "along": chain.rotation @ (np.eye(3) - onto),
        "across": chain.rotation @ skew,
        "flange": chain.flange,
        "gravity": np.array(model.robot.model.gravity.linear),
        "rigid": model.inertial.reshape(dof, 10),
    }
    for term in model.terms:
        form = term.effect.portable
        if form.bodies:
            bodies = form.bodies(term.theta, term.joints, model.robot)
            arrays["added"] = arrays.get("added", 0.0) + bodies.reshape(-1, 10)
        if form.gravity:
            tilt = form.gravity(term.theta, model.robot)
            arrays["tilt"] = arrays.get("tilt", 0.0) + tilt
        if form.force:
            arrays["force"] = arrays.get("force", 0.0) + form.force(term.theta)
    if shifted or "tilt" in arrays:
        state = model.state(1.0, np.zeros(1), np.zeros((3, 1, dof)))
        arrays["loaded"] = np.asarray(state.inertial).reshape(dof, 10)
        if shifted:
            arrays["drive"] = np.asarray(state.drive)
    return arrays


def _torque(
    model: Model,
    arrays: Mapping[str, Array],
    shifts: Sequence[Term],
    tables: Sequence[JointCorrection],
) -> tuple[list[str], int]:
    """The function that computes the torque, and the size of its memory."""
    p, dof, motion = "@P@", model.robot.dof, "angle, speed, acceleration"
    lines = [
        _HEAD,
        f"    double rigid_[{dof}], sign_[{dof}], total[{dof}], part[{dof}];",
        "    (void)memory, (void)t, (void)part;",
        f"    {p}_body({p}_rigid, {p}_gravity, 0, {motion}, rigid_);",
        _each(dof, "total[i] = rigid_[i];"),
    ]
    memory = 0
    floor = model.speed_floor
    floor = np.full(dof, LEAST_SPEED) if floor is None else floor
    for j, shape in enumerate(model.standstill or (SMOOTH,) * dof):
        if shape.kind == "smooth":
            text = f"tanh(speed[{j}] / {shape.size * float(floor[j])!r})"
        elif shape.size == 0.0:
            text = f"@P@_sgn(speed[{j}])"
        else:
            place = f"memory->number + {memory}"
            text = f"@P@_bristle({place}, angle[{j}], {float(shape.size)!r})"
            memory += BRISTLE
        lines.append(f"    sign_[{j}] = {text};")
        if shape.hold != 1.0:
            slow = f"fabs(speed[{j}]) < {shape.reach * float(floor[j])!r}"
            lines.append(f"    if ({slow}) sign_[{j}] *= {float(shape.hold)!r};")
    if "added" in arrays:
        lines.append(_part(dof, f"{p}_added, {p}_gravity, 0, {motion}"))
    if "tilt" in arrays:
        lines.append(f"    static const double at_rest[{dof}] = {{0.0}};")
        lines.append(_part(dof, f"{p}_loaded, {p}_tilt, 0, angle, at_rest, at_rest"))
    if "force" in arrays:
        lines.append(f"    static const double no_body[{dof}][10] = {{{{0.0}}}};")
        lines.append(f"    static const double no_gravity[3], unmoved[{dof}] = {{0.0}};")
        push = f"no_body, no_gravity, {p}_force, angle, unmoved, unmoved"
        lines.append(_part(dof, push))
    if shifts:
        lines += _shifted(dof, shifts)
    report = []  # distortions of the torque report come last
    for term in model.terms:
        form = term.effect.portable
        rows = term.effect.rows(term.joints, dof) if form.formula else ()
        for k, row in enumerate(rows):
            formula = form.formula[k if len(form.formula) > 1 else 0]
            block = _block(term, row, formula, memory)
            (report if EffectTrait.REPORT in term.effect.traits else lines).append(block)
            memory += form.memory
    lines += [_each(dof, "out[i] = total[i];"), *report, *_tables(tables), "}"]
    return lines, memory


def _each(dof: int, text: str) -> str:
    return f"    for (int i = 0; i < {dof}; i++) {text}"


def _part(dof: int, arguments: str) -> str:
    total = _each(dof, "total[i] += part[i];")
    return f"    @P@_body({arguments}, part);\n{total}"


def _block(term: Term, row: int, formula: str, memory: int) -> str:
    """One formula on one joint, with only the names that it uses."""
    words, lines = set(WORD.findall(formula)), []
    if "a" in words:
        lines.append(f"static const double a[] = {_list(term.theta)};")
    if "s" in words:
        lines.append(f"static const double s[] = {_list(term.shape)};")
    if "m" in words:
        lines.append(f"double *m = memory->number + {memory};")
    joints = term.joints if term.effect.scope == "pair" else (row,)
    formula = re.sub(r"\b(sgn|bristle|earlier)\(", r"@P@_\1(", formula)
    target = "out" if EffectTrait.REPORT in term.effect.traits else "total"
    lines += [*_names(words, joints), f"{target}[{row}] += {formula};"]
    return _braces(_title(term), lines)


def _names(words: Collection[str], joints: Collection[int]) -> Iterator[str]:
    for name in sorted(set(words) & {*_ARRAYS} - {"tau_model"}):
        first, *more = (f"{_ARRAYS[name]}[{j}]" for j in joints)
        pair = f"{name}[] = {{{', '.join([first, *more])}}}"
        yield f"const double {pair if more else f'{name} = {first}'};"


def _braces(title: str, lines: Iterable[str]) -> str:
    inner = (f"        {line}" for line in lines)
    return "\n".join([f"    {{ /* {title} */", *inner, "    }"])


def _shifted(dof: int, shifts: Sequence[Term]) -> Iterator[str]:
    """Torque by encoder errors: a step along the imaginary axis gives a derivative."""
    yield f"    double shift[3][{dof}] = {{{{0.0}}}};"
    for term in shifts:
        formulas, (j,) = term.effect.portable.shift or (), term.joints
        words = set(WORD.findall(" ".join(formulas)))
        lines = [
            f"static const double a[] = {_list(term.theta)};",
            *_names(words & {"q", "qd", "qdd"}, (j,)),
            *(f"shift[{k}][{j}] += {text};" for k, text in enumerate(formulas)),
        ]
        yield _braces(_title(term), lines)
    yield f"    double complex x[3][{dof}], change[{dof}];"
    rows = (
        f"x[{k}][i] = {name}[i] + {_STEP} * I * shift[{k}][i];"
        for k, name in enumerate(("angle", "speed", "acceleration"))
    )
    yield _each(dof, "{\n        " + "\n        ".join(rows) + "\n    }")
    yield "    @P@_change(@P@_loaded, @P@_gravity, 0, x[0], x[1], x[2], change);"
    drive = "@P@_drive[0][i] * shift[1][i] + @P@_drive[1][i] * shift[2][i]"
    yield _each(dof, f"total[i] += cimag(change[i]) / {_STEP} + {drive};")


def _tables(every: Sequence[JointCorrection]) -> Iterator[str]:
    """The blocks that add the tables of each joint, in their order."""
    level_names: dict[tuple, str] = {}
    for number, tables in enumerate(every):
        lookup = tables.lookup
        reads = [
            (" - " if form == DIFFERENCE else " + ").join(f"{_ARRAYS[on]}[{j}]" for j in of)
            for on, of, form in tables.columns
        ]
        reads = [*reads, f"out[{tables.joint}]"][: len(lookup.names)]
        levels = []
        for k, axis in enumerate(lookup.axes):
            # Joints often share level indices, whose search costs most.
            key = reads[axis.variable], axis.edges.tobytes()
            if key not in level_names:
                level_names[key] = f"level_{len(level_names)}"
                edges = axis.edges if len(axis.edges) else [0.0]
                yield f"    {_constant(f'edges_{number}_{k}', edges)}"
                call = f"@P@_level(edges_{number}_{k}, {len(axis.edges)}, {key[0]})"
                yield f"    const int {level_names[key]} = {call};"
            levels.append(level_names[key])
        lines = [f"double y = {float(lookup.offset[0])!r};"]
        for i in np.flatnonzero(lookup.slope[:, 0]):
            lines.append(f"y += {float(lookup.slope[i, 0])!r} * ({reads[i]});")
        for k, table in enumerate(lookup.tables):
            values = table.values[..., 0]
            first, *more = (levels[axis] for axis in table.axes)
            at = f"{first} * {values.shape[1]} + {more[0]}" if more else first
            lines.append(_constant(f"cells_{number}_{k}", values.ravel()))
            lines.append(f"y += cells_{number}_{k}[{at}];")
        if tables.beyond == NOTHING:
            # Outside the range of its data such a table is zero.
            lines += [
                f"const double x[] = {{{', '.join(reads)}}};",
                _constant("low", lookup.low),
                _constant("high", lookup.high),
                f"for (int i = 0; i < {len(reads)}; i++)"
                " if (x[i] < low[i] || x[i] > high[i]) y = 0.0;",
            ]
        lines.append(f"out[{tables.joint}] += y;")
        yield _braces(f"tables on joint {tables.joint + 1}", lines)


def _constant(name: str, values: Iterable) -> str:
    return f"static const double {name}[] = {_list(list(values))};"


def _list(values) -> str:
    if np.ndim(values) == 0:
        return repr(float(values))
    inner = ",\n    " if np.ndim(values) > 1 else ", "
    return "{" + inner.join(_list(v) for v in values) + "}"


def _comment(parts: Iterable[str]) -> str:
    return ",\n     ".join(parts).replace("*/", "")


def fill_template(text: str, values: Mapping[str, str]) -> str:
    """Return a text with each @NAME@ replaced by its value."""
    for name, word in values.items():
        text = text.replace(f"@{name}@", word)
    return text


def read_template(name: str) -> str:
    """Return a text of the folder `templates`."""
    folder = resources.files("residual") / "export" / "templates"
    return folder.joinpath(name).read_text(encoding="utf-8")


# Friction over speed and torque over position, as CSV with few support points.
#
# For controllers with a compensation table per joint. Terms of the speed of their joint
# alone go into friction.csv, terms of its position alone into position.csv; rigid body,
# loads and other terms remain with the controller.


DENSE = 4001  # points at which the curve is evaluated
ENOUGH = 1e-3  # of the largest value: accuracy that suffices for a controller
SPEED, POSITION = "friction.csv", "position.csv"
_OF = {SPEED: {"qd", "sign"}, POSITION: {"q"}}
_MOTION = {"q", "qd", "qdd", "sign", "rigid", "tau", "t", "m"}
_MOST = {SPEED: 21, POSITION: 41}  # support points; controllers accept some twenty
_FEW = (-1.0, -0.5, -0.1, 0.0, 0.1, 0.5, 1.0)  # of the range: first points


def to_table(source: AnyModel) -> ModelExport:
    """Return support points of each joint as CSV files, look-up tables included."""
    made = split_exportable_terms(
        source,
        lambda t: "" if _file(t) else "it is not a function of one joint's speed or position",
    )
    files = {file: _csv(remove_tables(made.carried), file) for file in _OF}
    files = {file: text for file, text in files.items() if text}
    for own in made.carried.tables if isinstance(made.carried, CorrectedModel) else ():
        if own.kind != NONE:
            text = build_lookup_files(own.lookup)["tables.csv"]
            files[f"tables_{own.joint + 1}.csv"] = text
    body = replace(remove_tables(source), terms=())
    motion = build_reference_motion(body.robot)
    full, kept, rigid = (m.along(motion.t, motion.parts) for m in (source, made.carried, body))
    why = "the controller computes it"
    omissions = (
        OmittedTerm("rigid body", (), why, *measure_torque_difference(rigid)),
        *made.omissions,
    )
    rms, largest = measure_torque_difference(full - kept + rigid)
    return ModelExport(files, made.source, made.carried, omissions, rms, largest)


def _file(term: Term) -> str:
    """The table of a term, "" for none; a constant counts as friction."""
    said = term.effect.portable
    if len(said.formula) != 1 or len(term.joints) != 1:
        return ""
    words = set(WORD.findall(said.formula[0])) & _MOTION
    return next((name for name, own in _OF.items() if words <= own), "")


def _csv(model: Model, file: str) -> bytes:
    """Support points of the curves of each joint with any, b"" for none."""
    lower, upper, speed = fill_joint_limits(model.robot)
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    over = "qd [rad/s]" if file == SPEED else "q [rad]"
    head = ["joint", over, "torque [N m]"]
    # An arm with both kinds of joints has rows in both units.
    slides = set(model.robot.prismatic)
    sliding = [convert_to_sliding_unit(word) for word in head]
    both = [f"{a} or {b}" if a != b else a for a, b in zip(head, sliding, strict=True)]
    out.writerow({(True,): sliding, (False,): head}.get(tuple(slides), both))
    joints = {t.joints[0] for t in model.terms if _file(t) == file}
    for j in sorted(joints):
        ends = (-speed[j], speed[j]) if file == SPEED else (lower[j], upper[j])
        start = np.mean(ends) + np.diff(ends)[0] / 2 * np.array(_FEW)
        curve = partial(evaluate_table_curve, model, file, j)
        points = (x.tolist() for x in place_support_points(curve, start, _MOST[file]))
        for at, torque in zip(*points, strict=True):
            out.writerow([j + 1, repr(at), repr(torque)])
    return text.getvalue().encode() if joints else b""


def evaluate_table_curve(model: Model, file: str, joint: int, x: Array) -> Array:
    """Return the torque of a joint over its speed or position [SI]. Shape (n,)."""
    motion = np.zeros((3, len(x), model.robot.dof))
    motion[1 if file == SPEED else 0, :, joint] = x
    state = model.replace_bristles_by_sign().state(1.0, np.zeros(len(x)), motion)
    terms = [t for t in model.terms if _file(t) == file and t.joints == (joint,)]
    return sum((term.torque(state)[:, joint] for term in terms), np.zeros(len(x)))


def place_support_points(
    curve: Callable[[Array], Array], start: Array, max_count: int
) -> tuple[Array, Array]:
    """Return places of support points of a curve, and its values there. Shapes (k,).

    A point is added where the interpolation error is largest, until it is negligible or
    the largest number is reached. The ends of the range are the ends of `start`.
    """
    ends = np.linspace(start[0], start[-1], DENSE)
    # Features near zero are narrow.
    near = np.concatenate([-np.geomspace(1e-5, 1, DENSE), np.geomspace(1e-5, 1, DENSE)])
    size = max(abs(start[0]), abs(start[-1]))
    inside = near[(near * size > start[0]) & (near * size < start[-1])] * size
    x = np.unique(np.concatenate([ends, inside, start]))
    y, points = curve(x), np.unique(start)
    while True:
        gap = np.abs(np.interp(x, points, np.interp(points, x, y)) - y)
        worst = int(np.argmax(gap))
        if len(points) >= max_count or gap[worst] <= ENOUGH * np.abs(y).max():
            return points, np.interp(points, x, y)
        points = np.sort(np.append(points, x[worst]))
