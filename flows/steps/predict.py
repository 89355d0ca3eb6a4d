"""Torque of a model on logs, whole and with effects taken out of it."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from flows.inputs.given import LogSets, is_run, load_of, need_logs, read_sets, robot_of
from flows.requests import Predict, View
from flows.settings import store_folder
from flows.steps.models import diagnosis_of, nominal_of, read_model
from flows.storage.diagnosis import read_models, read_verdict
from residual.diagnosis.conclude import error_tables
from residual.diagnosis.result import ErrorTables, Finding, Verdict
from residual.errors import InputError
from residual.export.exported import Whole, body_of
from residual.lazy import one_blas_thread
from residual.model.compare import EDITED, WHOLE, Edits, Prediction
from residual.model.compare import predict as core_predict
from residual.quantity import plain
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.robot.shapes import Look, look_of

_NAMES = {WHOLE: "tau_model", EDITED: "tau_edited"}
FORMS = (".csv", ".parquet")


def read(request: Predict) -> tuple[Whole, LogSets]:
    """Read the model and every log once."""
    need_logs(request.logs, "to predict", "predict")
    store = store_folder(request.store)
    model = read_model(store, request.model, request.which)
    sets = (request.logs, (), ())
    return model, read_sets(sets, body_of(model).robot, request.columns, store)


@one_blas_thread
def predict(request: Predict, model: Whole, logs: LogSets) -> Prediction:
    """Compute the torque of the model on the logs."""
    return core_predict(model, logs.fit, parse_edits(request.without))


def parse_edits(words: Sequence[str]) -> Edits:
    """Return names and joints of "NAME" or "NAME@JOINT[,JOINT]"."""
    out = []
    for word in words:
        name, at, joints = word.partition("@")
        try:
            numbers = tuple(int(joint) for joint in joints.split(",")) if at else ()
        except ValueError as error:
            raise InputError(
                f"--without {word}: expected NAME or NAME@JOINT, as coulomb@3."
            ) from error
        out.append((name, numbers))
    return out


def tables(made: Prediction) -> ErrorTables:
    """Return the errors against what was measured, by model [%]."""
    ids = [log.id for log in made.logs]
    return error_tables(dict(made.errors), made.cutoff, ids)


def document(made: Prediction, request: Predict) -> dict:
    """Return errors as plain values, in the form that a verdict has them."""
    return {
        "schema": 1,
        "model": repr(made.models[WHOLE]),
        "without": list(request.without),
        "error": plain(asdict(tables(made))),
    }


def samples(made: Prediction) -> pa.Table:
    """Return log, time, measured torque and that of each model, a row per sample."""
    parts = []
    for log, torque in zip(made.logs, made.torque, strict=True):
        columns = {"log": [log.id] * len(log.t), "t": log.t}
        for name, values in (("tau", log.tau), *torque.items()):
            head = _NAMES.get(name, name)
            columns |= {
                f"{head}{j + 1}": np.ascontiguousarray(values[:, j])
                for j in range(log.dof)
            }
        parts.append(pa.table(columns))
    return pa.concat_tables(parts)


def check_form(path: Path) -> None:
    """Refuse a file of another form than can be written."""
    if path.suffix not in FORMS:
        raise InputError(f"--out {path}: expected a file *.csv or *.parquet.")


def written(made: Prediction, path: Path) -> bytes:
    """Return the samples in the form that a file name asks for."""
    sink = io.BytesIO()
    if path.suffix == ".csv":
        pc.write_csv(samples(made), sink)
    else:
        pq.write_table(samples(made), sink, compression="zstd")
    return sink.getvalue()


@dataclass(frozen=True, eq=False, slots=True)
class Viewed:
    """What is shown of a log."""

    robot: Robot  # the arm
    look: Look  # what it looks like
    log: Recording
    # Of each model, its torque [N m]: "nominal", and with a verdict "identified" and
    # "augmented". Shapes (n, dof).
    torque: Mapping[str, Array]
    # Every finding with its torque [N m]. Shapes (n, dof).
    effects: tuple[tuple[Finding, Array], ...]
    verdict: Verdict | None  # the verdict; None where none was asked for
    lines: tuple[str, ...]  # what was understood of the log


@one_blas_thread
def view(request: View) -> Viewed:
    """Read a log and compute the torque of its models."""
    store = store_folder(request.store)
    verdict, models = _models(request, store)
    robot = _robot(request, store, models)
    sets = read_sets(((request.log,), (), ()), robot, request.columns, store)
    (log,) = sets.fit
    if not models:
        models = {"nominal": nominal_of(robot, sets.fit)}
    torque = {name: model.predict(log) for name, model in models.items()}
    effects = tuple(
        (effect, torque["augmented"] - _without(models["augmented"], effect, log))
        for effect in (verdict.effects if verdict else ())
    )
    folder = _folder(request.robot)
    return Viewed(
        robot, look_of(robot, folder), log, torque, effects, verdict, sets.lines[1:]
    )


def _models(request: View, store: Path) -> tuple[Verdict | None, Mapping[str, Whole]]:
    if request.verdict is None:
        return None, {}
    id = diagnosis_of(store, request.verdict)
    kept = {k: m for k, m in read_models(store, id).items() if k != "plsr"}
    return read_verdict(store, id), kept


def _robot(request: View, store: Path, models: Mapping[str, Whole]) -> Robot:
    runs = [request.log] if is_run(request.log) else []
    word = request.robot
    if word is None and not models and runs:
        word = robot_of(runs, store)
    if word is None and not models:
        raise InputError(
            f"{request.log} does not say which robot it is of. Name it: --robot "
            "irb140, or a URDF file."
        )
    named = None if word is None else load_of(word, runs, store)
    if not models:
        return named
    own = body_of(models["augmented"]).robot
    if named is not None and (named.name, named.dof) != (own.name, own.dof):
        raise InputError(
            f"--verdict {request.verdict} is of {own.name} with {own.dof} joints, "
            f"--robot says {named.name} with {named.dof}. Give a verdict of this robot."
        )
    return named or own


def _without(model: Whole, effect: Finding, log: Recording) -> Array:
    """Torque of a model with one finding taken out; nothing is refitted."""
    return model.without(effect.name, effect.joints or None).predict(log)


def _folder(word: str | None) -> Path | None:
    """Return where the URDF of a robot lies; None for one that is built in."""
    if word is None or not Path(word).exists():
        return None
    return Path(word) if Path(word).is_dir() else Path(word).parent
