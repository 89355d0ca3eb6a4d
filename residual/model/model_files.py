"""A model as JSON values, and back; as the files of a robot."""

import json
from collections.abc import Mapping
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import tomli_w

from residual.effects.base import EffectTrait
from residual.errors import InputError, check_nesting
from residual.model.lookup import AnyModel, CorrectedModel, remove_tables
from residual.model.model import Model, Term
from residual.recording import Array
from residual.robot.robot import write_urdf_with_inertias
from residual.signals.track import CHOICES

SLOWEST = 1e-3  # Hz: a period of a quarter of an hour; no motion filter is slower
TABLES = "the tables of a calibration"
LARGEST = 64 << 20  # largest file whose kind is identified, bytes
FASTEST = 1e6  # Hz: no controller logs faster, and memory grows with it


_AGAIN = "Write it again: modelgap diagnose LOG... --save-model FILE."


def _wrong(model: Model) -> str | None:
    dof, floor, filters = model.robot.dof, model.speed_floor, astuple(model.filters)
    kinds = {shape.kind for shape in CHOICES}
    shapes = [s for s in model.standstill if s.kind not in kinds or not _numbers(s)]
    if not _is(model.inertial, (10 * dof,)):
        return f"inertial is no list of {10 * dof} numbers"
    if floor is not None and not (_is(floor, (dof,)) and (floor > 0).all()):
        return f"speed_floor is no list of {dof} positive numbers"
    if shapes or len(model.standstill) not in (0, dof):
        return f"standstill has no usable entry for each of {dof} joints"
    if model.clock is not None and not _is(np.array(model.clock), ()):
        return "clock is no number"
    if not all(_is(np.array(f), ()) and 0 <= f < FASTEST for f in filters):
        return "filters has a value that no signal path has"
    path = model.filters
    if min(path.kinematics, path.torque, path.rate) <= SLOWEST:
        return "filters has a cut-off or rate of 0"
    terms = (word for term in model.terms if (word := _wrong_term(term, model)))
    return next(terms, None)


def _wrong_term(term: Term, model: Model) -> str | None:
    dof, name = model.robot.dof, term.effect.name
    whole = all(type(j) is int for j in term.joints)
    if not whole or not set(range(dof)).issuperset(term.joints):
        return f"{name} sits on a joint that the robot does not have"
    numbers = _is(term.theta, (len(term.theta),)) if term.theta.ndim else False
    if not numbers or not _is(np.array(term.shape), (len(term.shape),)):
        return f"{name} has a coefficient that is no number"
    try:
        term.parameters(model.robot)
        if not term.effect.traits & (EffectTrait.MEMORY | EffectTrait.NEEDS_CLOCK):
            replace(model, terms=(term,)).torque(*np.zeros((3, 1, dof)))
    except (IndexError, TypeError, ValueError):
        return f"{name} has another number of coefficients or joints than it takes"
    return None if term.nominal is None else _wrong_term(term.nominal, model)


def _numbers(shape) -> bool:
    values = np.array([shape.size, shape.hold, shape.reach])
    return _is(values, (3,)) and bool((values >= 0).all())


def _is(values: Array, shape: tuple[int, ...]) -> bool:
    """Whether values are finite numbers of a shape; booleans are not."""
    return values.dtype.kind in "if" and values.shape == shape and bool(np.isfinite(values).all())


# Python errors from lists and tables of wrong sizes and kinds.
_DAMAGED = (AttributeError, IndexError, KeyError, OverflowError, TypeError, ValueError)


def format_model(model: AnyModel) -> str:
    """Return a model as the text of a file, which ``load_model`` reads."""
    return json.dumps(model.to_record(), allow_nan=False) + "\n"


def model_from_record(record: Mapping) -> AnyModel:
    """Return the model of a record.

    Raises:
        InputError: If it is of another form, or damaged.
    """
    try:
        model = (CorrectedModel if "tables" in record else Model).from_record(record)
        wrong = _wrong(remove_tables(model))
    except _DAMAGED as error:
        lacks, size = f"it lacks the key {error}", "a value has another kind or size"
        wrong = lacks if isinstance(error, KeyError) else size
        raise InputError(f"The record of a model is damaged: {wrong}. {_AGAIN}") from error
    if wrong:
        raise InputError(f"The record of a model is damaged: {wrong}. {_AGAIN}")
    return model


def load_model(path: str | Path) -> AnyModel:
    """Return the model that was saved into a file.

    Raises:
        InputError: If the file cannot be read or holds no model.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except RecursionError as error:
        raise InputError(f"{path} is no model: it is nested too deep.") from error
    except OSError as error:
        raise InputError(f"Cannot read {path}: {error.strerror}.") from error
    except ValueError as error:
        got = "other data"
        if isinstance(error, json.JSONDecodeError):
            got = f"an error in line {error.lineno}, column {error.colno}"
        raise InputError(
            f"{path} is not the file of a model: expected JSON, got {got}. {_AGAIN}"
        ) from error
    if not isinstance(content, dict):
        raise InputError(f"{path} is not the file of a model: expected a JSON object. {_AGAIN}")
    check_nesting(content, str(path))
    kind = _kind(content)
    if kind == TABLES:
        raise InputError(
            f"{path} holds {kind}, expected a model: that is corrected.json beside it, "
            "which modelgap calibrate --out writes without --paper."
        )
    if kind != "a model":
        raise InputError(
            f"{path} holds {kind}, expected a model: modelgap diagnose --save-model "
            "FILE or Model.save writes one, and a stored diagnosis has one by its id."
        )
    return model_from_record(content)


def identify_file_content(path: str | Path) -> str:
    """Return the content of one of our files: "a model", "a verdict", `TABLES`, or other.

    Raises:
        OSError: If there is no such file, or it cannot be read.
    """
    with Path(path).open("rb") as file:
        data = file.read(LARGEST + 1)
    try:
        content = json.loads(data.decode()) if len(data) <= LARGEST else None
    except (ValueError, RecursionError):
        content = None
    return _kind(content if isinstance(content, dict) else {})


def _kind(content: Mapping) -> str:
    if {"variables", "tables"} <= set(content):
        return TABLES
    if "tables" in content or "form" in content:
        return "a model"
    return "a verdict" if {"verdict", "effects"} <= set(content) else "something else"


# An identified model as the files of a robot: URDF, and robot.toml beside it.


_HEAD = """\
# Identified parameters of {name}, written by modelgap.
# Give this folder as --robot; inertias are in the URDF beside this file.
"""


def build_robot_folder(model: Model, source: str = "") -> dict[str, bytes]:
    """Return a model as the files of a robot folder.

    Returns:
        Content by file name: one *.urdf and robot.toml; together they reload to a
        model of the same torque.

    Raises:
        InputError: If a link's mass is not positive, or an effect's values do not fit
            into a robot.toml.
    """
    name = model.robot.name
    urdf = write_urdf_with_inertias(model.robot, model.inertial)
    content = json.loads(model.robot.toml)
    gravity = [float(g) for g in model.robot.model.gravity.linear]
    content["robot"] = content.get("robot", {}) | {"name": name, "gravity": gravity}
    content["declared"] = {
        effect: {key: [float(v) for v in array] for key, array in values.items()}
        | ({"source": source} if source else {})
        for effect, values in _declared_values(model).items()
    }
    toml = _HEAD.format(name=name) + tomli_w.dumps(content)
    return {f"{name}.urdf": urdf.encode(), "robot.toml": toml.encode()}


def _declared_values(model: Model) -> dict[str, dict[str, np.ndarray]]:
    """Values of the model's effects by name and parameter key. (dof,) each."""
    out: dict[str, dict[str, np.ndarray]] = {}
    places = set()
    for term in model.terms:
        name, anchor = term.effect.name, term.joints[0] if term.joints else 0
        if (name, anchor) in places:
            raise InputError(
                f"{name} on joint {anchor + 1} was fitted in several shapes at once, "
                "and a robot.toml holds one. Give its values in robot.toml, or leave "
                "it out of --declared."
            )
        places.add((name, anchor))
        values = term.effect.values(term.theta, term.shape, model.robot)
        table = out.setdefault(name, {})
        for key, value in zip(term.effect.parameters, values, strict=True):
            table.setdefault(key, np.zeros(model.robot.dof))[anchor] = value
    return out
