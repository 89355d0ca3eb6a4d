"""Predict the torque of logs with a model, and with effects removed from it."""

import io
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from flows.inputs.read import LogSets, need_logs, read_sets
from flows.requests import Predict
from flows.settings import store_folder
from flows.steps.models import read_model
from residual import one_blas_thread
from residual.errors import InputError
from residual.export.export import AnyModel, without_tables
from residual.model.compare import EDITED, WHOLE, Edits, Prediction
from residual.model.compare import predict as core_predict
from residual.quantity import plain
from residual.verdict.result import ErrorTables, error_tables

_NAMES = {WHOLE: "tau_model", EDITED: "tau_edited"}
FORMS = (".csv", ".parquet")


def read(request: Predict) -> tuple[AnyModel, LogSets]:
    """Read the model and every log once."""
    need_logs(request.logs, "to predict", "predict")
    store = store_folder(request.store)
    model = read_model(store, request.model, request.which)
    sets = (request.logs, (), ())
    return model, read_sets(sets, without_tables(model).robot, request.columns, store)


@one_blas_thread
def predict(request: Predict, model: AnyModel, logs: LogSets) -> Prediction:
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


def tables(prediction: Prediction) -> ErrorTables:
    """Return the errors against what was measured, by model [%]."""
    ids = [log.id for log in prediction.logs]
    return error_tables(dict(prediction.errors), prediction.cutoff, ids)


def document(prediction: Prediction, request: Predict) -> dict:
    """Return errors as plain values, in the form that a verdict has them."""
    return {
        "schema": 1,
        "model": repr(prediction.models[WHOLE]),
        "without": list(request.without),
        "error": plain(asdict(tables(prediction))),
    }


def samples(prediction: Prediction) -> pa.Table:
    """Return log, time, measured torque and that of each model, a row per sample."""
    parts = []
    for log, torque in zip(prediction.logs, prediction.torque, strict=True):
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


def written(prediction: Prediction, path: Path) -> bytes:
    """Return the samples in the form that a file name asks for."""
    sink = io.BytesIO()
    if path.suffix == ".csv":
        pc.write_csv(samples(prediction), sink)
    else:
        pq.write_table(samples(prediction), sink, compression="zstd")
    return sink.getvalue()
