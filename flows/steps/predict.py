"""Predict the torque of logs with a model, and with effects removed from it."""

import io
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from flows.inputs.read import LogSets, read_log_sets, require_logs
from flows.settings import resolve_store_folder
from flows.steps.model_choice import read_model
from residual import one_blas_thread
from residual.errors import InputError
from residual.export.model_export import AnyModel, remove_tables
from residual.model.compare import EDITED, WHOLE, Edits, Prediction
from residual.model.compare import predict_logs as core_predict
from residual.quantity import convert_to_plain_values
from residual.verdict.diagnosis import tabulate_errors
from residual.verdict.result import ErrorTables

_NAMES = {WHOLE: "tau_model", EDITED: "tau_edited"}
FORMS = (".csv", ".parquet")


def read_model_and_logs(
    word: str,
    logs: Sequence[str],
    which: str | None = None,
    columns: str | None = None,
    store: str | Path | None = None,
) -> tuple[AnyModel, LogSets]:
    """Read the model and every log once."""
    require_logs(logs, "to predict", "predict")
    place = resolve_store_folder(store)
    model = read_model(place, word, which)
    robot = remove_tables(model).robot
    return model, read_log_sets((logs, (), ()), robot, columns, place)


@one_blas_thread
def predict(model: AnyModel, logs: LogSets, without: Sequence[str]) -> Prediction:
    """Compute the torque of the model on the logs."""
    return core_predict(model, logs.fit, parse_edits(without))


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


def describe_edited_model(prediction: Prediction, without: Sequence[str]) -> list[str]:
    """Return the edited model and what was removed, in one line; none without edits."""
    if EDITED not in prediction.models:
        return []
    edited, words = prediction.models[EDITED], []
    terms = remove_tables(edited).terms
    for word, (name, joints) in zip(without, parse_edits(without), strict=True):
        # An effect of the nominal model goes back to its value there.
        nominal = any(
            term.effect.name == name and (not joints or {j + 1 for j in term.joints} & set(joints))
            for term in terms
        )
        words.append(f"{word} (at its nominal value)" if nominal else word)
    return [f"edited: {edited!r}, without {', '.join(words)}"]


def build_error_tables(prediction: Prediction) -> ErrorTables:
    """Return the errors against what was measured, by model [%]."""
    ids = [log.id for log in prediction.logs]
    return tabulate_errors(dict(prediction.errors), prediction.cutoff, ids)


def build_prediction_document(prediction: Prediction, without: Sequence[str]) -> dict:
    """Return errors as plain values, in the form that a verdict has them."""
    return {
        "schema": 1,
        "model": repr(prediction.models[WHOLE]),
        "without": list(without),
        "error": convert_to_plain_values(asdict(build_error_tables(prediction))),
    }


def build_sample_table(prediction: Prediction) -> pa.Table:
    """Return log, time, measured torque and that of each model, a row per sample."""
    parts = []
    for log, torque in zip(prediction.logs, prediction.torque, strict=True):
        columns = {"log": [log.id] * len(log.t), "t": log.t}
        for name, values in (("tau", log.tau), *torque.items()):
            head = _NAMES.get(name, name)
            columns |= {
                f"{head}{j + 1}": np.ascontiguousarray(values[:, j]) for j in range(log.dof)
            }
        parts.append(pa.table(columns))
    return pa.concat_tables(parts)


def check_file_format(path: Path) -> None:
    """Refuse a file of another form than can be written."""
    if path.suffix not in FORMS:
        raise InputError(f"--out {path}: expected a file *.csv or *.parquet.")


def encode_samples(prediction: Prediction, path: Path) -> bytes:
    """Return the samples in the form that a file name asks for."""
    sink = io.BytesIO()
    if path.suffix == ".csv":
        pc.write_csv(build_sample_table(prediction), sink)
    else:
        pq.write_table(build_sample_table(prediction), sink, compression="zstd")
    return sink.getvalue()
