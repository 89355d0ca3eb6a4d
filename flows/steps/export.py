"""Predict with a model, with or without its effects, and export it to other programs."""

import io
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from flows.inputs import LogSets, read_log_sets, require_logs
from flows.settings import resolve_store_folder
from flows.steps.model_choice import read_model
from residual import one_blas_thread
from residual.errors import InputError, check_name
from residual.export.c99 import to_c99, to_table
from residual.export.model_export import (
    AnyModel,
    ModelExport,
    build_reference_motion,
    make_file_stem,
    remove_tables,
    split_exportable_terms,
    to_json,
)
from residual.export.urdf_mjcf import to_mjcf, to_mujoco, to_urdf
from residual.model.compare import EDITED, WHOLE, Edits, Prediction
from residual.model.compare import predict_logs as core_predict
from residual.plugins import load_plugins
from residual.quantity import convert_to_plain_values
from residual.recording import Array, Recording
from residual.robot.dynamics import build_kinematic_chain
from residual.signals.track import build_tracks
from residual.verdict.diagnosis import tabulate_errors
from residual.verdict.result import ErrorTables

_NAMES = {WHOLE: "tau_model", EDITED: "tau_edited"}


@one_blas_thread
def predict(
    logs: Sequence[str],
    model: str,
    which: str | None = None,
    without: Sequence[str] = (),
    columns: str | None = None,
    store: str | Path | None = None,
) -> tuple[LogSets, Prediction]:
    """Read a model and logs, and compute the torque with and without some effects."""
    require_logs(logs, "to predict", "predict")
    place = resolve_store_folder(store)
    source = read_model(place, model, which)
    read = read_log_sets((logs, (), ()), remove_tables(source).robot, columns, place)
    return read, core_predict(source, read.fit, parse_edits(without))


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


def describe_models(prediction: Prediction, without: Sequence[str]) -> list[str]:
    """Return the model, then the edited one and what was removed, a line each."""
    lines = [f"model: {prediction.models[WHOLE]!r}"]
    if EDITED not in prediction.models:
        return lines
    edited, words = prediction.models[EDITED], []
    terms = remove_tables(edited).terms
    for word, (name, joints) in zip(without, parse_edits(without), strict=True):
        # An effect of the nominal model goes back to its value there.
        nominal = any(
            term.effect.name == name and (not joints or {j + 1 for j in term.joints} & set(joints))
            for term in terms
        )
        words.append(f"{word} (at its nominal value)" if nominal else word)
    return [*lines, f"edited: {edited!r}, without {', '.join(words)}"]


def build_error_tables(prediction: Prediction) -> ErrorTables:
    """Return the errors against the measured torque, by model [%]."""
    ids = [log.id for log in prediction.logs]
    return tabulate_errors(dict(prediction.errors), prediction.cutoff, ids)


def build_prediction_document(prediction: Prediction, without: Sequence[str]) -> dict:
    """Return errors as plain values, in the form of a verdict."""
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


def encode_samples(prediction: Prediction, path: Path) -> bytes:
    """Return the samples in the format of a file name."""
    sink = io.BytesIO()
    if path.suffix == ".csv":
        pc.write_csv(build_sample_table(prediction), sink)
    else:
        pq.write_table(build_sample_table(prediction), sink, compression="zstd")
    return sink.getvalue()


APP, CLOCK, ARM = "modelgap", "time", "arm"
THICK = 0.02  # m, of the lines that stand for links


def build_rerun_recording(source: AnyModel, log: Recording | None = None) -> ModelExport:
    """Return a recording of a log, or of the exports' motion where there is none."""
    try:
        import rerun as rr
    except ImportError as error:
        raise InputError(
            "This target needs Rerun, which is not installed. Install the extra: pip "
            "install '.[export]' in the checkout."
        ) from error
    model = remove_tables(source)
    if log is None:
        motion = build_reference_motion(model.robot)
        t, q = motion.t, motion.q
        torque = _torque(source, model.state(1 / t[1], t, motion.parts))
    else:
        (track,), _ = build_tracks([log], model.filters, model.speed_floor, True)
        t, q, torque = track.t, track.q, _torque(source, model.observe(track))
        measured = np.column_stack([np.interp(t, log.t, c) for c in log.tau.T])
        torque |= {"measured": measured, "residual": measured - torque["model"]}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.rrd"
        stream = rr.RecordingStream(APP, recording_id=make_file_stem(source))
        stream.save(str(path))
        _draw(rr, stream, source, t, q, torque)
        stream.flush()
        stream.disconnect()
        content = path.read_bytes()
    made = split_exportable_terms(source, lambda term: "")
    return replace(made, files={f"{make_file_stem(source)}.rrd": content})


def _torque(source: AnyModel, state) -> dict[str, Array]:
    """Torque of the model [N m], and its summands. Shapes (n, dof)."""
    model, total = remove_tables(source), source.torque_of_state(state)
    parts = {"model": total, "of/rigid_body": state.regressor @ model.inertial}
    for term in model.terms:
        name = f"of/{term.effect.name}"
        parts[name] = parts.get(name, 0.0) + term.torque(state)
    if source is not model:
        parts["of/tables"] = total - model.torque_of_state(state)
    return parts


def _draw(rr, stream, source: AnyModel, t: Array, q: Array, torque: Mapping[str, Array]) -> None:
    clock = [rr.TimeColumn(CLOCK, duration=t)]
    for name, values in torque.items():
        for j, column in enumerate(values.T):
            # An effect on other joints only would be a flat line here.
            if column.any() or not name.startswith("of/"):
                path = f"torque/joint_{j + 1}/{name}"
                stream.send_columns(path, clock, rr.Scalars.columns(scalars=column))
    chain, path = build_kinematic_chain(remove_tables(source).robot.model), ARM
    _line(rr, stream, path, chain.place[0])
    for j, end in enumerate([*chain.place[1:], chain.flange]):
        path = f"{path}/link_{j + 1}"
        turns = [
            pin.Quaternion(chain.rotation[j] @ pin.AngleAxis(x, chain.axis[j]).matrix())
            for x in q[:, j]
        ]
        pose = rr.Transform3D.columns(
            translation=np.tile(chain.place[j], (len(turns), 1)),
            quaternion=np.array([turn.coeffs() for turn in turns]),
        )
        stream.send_columns(path, clock, pose)
        _line(rr, stream, path, end)


def _line(rr, stream, path: str, end: Array) -> None:
    strip = rr.LineStrips3D([np.array([np.zeros(3), end])], radii=THICK)
    stream.log(path, strip, static=True)


Writer = Callable[[AnyModel], ModelExport]
TARGETS: Mapping[str, Writer] = {
    "urdf": to_urdf,
    "mjcf": to_mjcf,
    "mujoco": to_mujoco,
    "c99": to_c99,
    "table": to_table,
    "rrd": build_rerun_recording,
    "json": to_json,
}


def list_export_targets() -> Mapping[str, Writer]:
    """Return all targets: ours, and those of plug-ins."""
    result = dict(TARGETS)
    for name, write in load_plugins("modelgap.exporters").items():
        if name in result or not callable(write):
            raise InputError(
                f"The plug-in '{name}' (modelgap.exporters): expected a function that "
                "takes a model, under a name that no other target has."
            )
        result[name] = write
    return result


def _check_target(word: str) -> str:
    """Return the name of a target; "c" is C99."""
    return check_name("c99" if word == "c" else word, list_export_targets(), "target")


def export(
    word: str,
    to: str,
    which: str | None = None,
    log: str | None = None,
    columns: str | None = None,
    store: str | Path | None = None,
) -> ModelExport:
    """Read a model and write it in the form of another program.

    Args:
        word: File of a model, or the id of a record.
        which: Which of the models of a diagnosis.
        log: With rrd: a log of the robot, read with a column map.

    Raises:
        InputError: If there is no such model or target, the target cannot take the
            model, or a package that it needs is not installed.
    """
    _check_target(to)
    place = resolve_store_folder(store)
    model = read_model(place, word, which)
    if log is None:
        return export_model(model, to)
    robot = remove_tables(model).robot
    (read,) = read_log_sets(((log,), (), ()), robot, columns, place).fit
    return export_model(model, to, read)


def export_model(model: AnyModel, to: str, log: Recording | None = None) -> ModelExport:
    """Write a model in the form of another program."""
    write = list_export_targets()[_check_target(to)]
    if log is not None and write is not build_rerun_recording:
        raise InputError(f"{to} takes no log; only rrd does.")
    return write(model) if log is None else build_rerun_recording(model, log)


def describe_export(result: ModelExport) -> list[str]:
    """Return model, locked joints and omissions of an export, a line each."""
    lines = [f"model: {result.source!r}"]
    locked = remove_tables(result.source).robot.locked
    if locked and any(name.endswith((".urdf", ".xml")) for name in result.files):
        places = ", ".join(f"{name} = {value:.4g}" for name, value in locked.items())
        lines.append(f"locked joints, exported as fixed: {places}")
    lines += [f"not exported: {omission}" for omission in result.omissions]
    if len(result.omissions) > 1:
        size = f"up to {result.largest:.3g} N m (rms {result.rms:.3g})"
        lines.append(f"not exported, together: {size}")
    if not result.omissions:
        lines.append("the export represents the whole model")
    return lines


def build_omissions_document(result: ModelExport) -> dict:
    """Return the omissions of an export as plain values."""
    return {
        "schema": 1,
        "files": sorted(result.files),
        "left": convert_to_plain_values([asdict(each) for each in result.omissions]),
        "missing": {"rms": result.rms, "largest": result.largest},
    }
