"""Friction over speed and torque over position, as CSV with few support points.

For controllers that take a table of compensation per joint. What depends on the speed
of its joint alone goes into friction.csv, what depends on its position alone into
position.csv; rigid body, loads and all else stay with the controller.
"""

import csv
import io
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from residual.export.c99 import WORD
from residual.export.model_export import (
    AnyModel,
    ModelExport,
    OmittedTerm,
    build_reference_motion,
    fill_joint_limits,
    measure_torque_difference,
    remove_tables,
    split_exportable_terms,
)
from residual.model.lookup import NONE, CorrectedModel, build_lookup_files
from residual.model.model import Model, Term
from residual.quantity import convert_to_sliding_unit
from residual.recording import Array

DENSE = 4001  # points that the curve is looked at
ENOUGH = 1e-3  # of the largest value: more points help no controller
SPEED, POSITION = "friction.csv", "position.csv"
_OF = {SPEED: {"qd", "sign"}, POSITION: {"q"}}
_MOTION = {"q", "qd", "qdd", "sign", "rigid", "tau", "t", "m"}
_MOST = {SPEED: 21, POSITION: 41}  # support points; controllers take some twenty
_FEW = (-1.0, -0.5, -0.1, 0.0, 0.1, 0.5, 1.0)  # of the range, where points begin


def to_table(source: AnyModel) -> ModelExport:
    """Return support points of each joint as CSV files; tables go along as they are."""
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
    """Which table a term belongs to, "" for none; a constant goes with friction."""
    said = term.effect.portable
    if len(said.formula) != 1 or len(term.joints) != 1:
        return ""
    words = set(WORD.findall(said.formula[0])) & _MOTION
    return next((name for name, own in _OF.items() if words <= own), "")


def _csv(model: Model, file: str) -> bytes:
    """Support points of the curves of each joint that has some, b"" for none."""
    lower, upper, speed = fill_joint_limits(model.robot)
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    over = "qd [rad/s]" if file == SPEED else "q [rad]"
    head = ["joint", over, "torque [N m]"]
    # An arm of both kinds has rows of both units, joint by joint.
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

    A point is added where the lines miss most, until they miss by next to nothing, or
    there are as many as may be. The ends of the range are the ends of `start`.
    """
    ends = np.linspace(start[0], start[-1], DENSE)
    # What happens near zero is narrow.
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
