"""Write a diagnosis and its report as records of the store, and read them back."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby, product
from pathlib import Path

import numpy as np
import pyarrow as pa

from residual.errors import InputError
from residual.model.compare import FindingScatter, LogPrediction
from residual.model.lookup import CorrectedModel
from residual.model.model import Model
from residual.model.model_files import model_from_record as read_model
from residual.recording import Recording
from residual.signals.splitting import pick_spread_pieces
from residual.signals.track import FilterSettings, resample_recording
from residual.verdict.document import parse_verdict, to_json
from residual.verdict.result import Diagnosis, ErrorTables, Finding, Verdict
from warehouse.record_commit import commit_diagnosis, commit_record
from warehouse.record_ids import build_record_path
from warehouse.store_catalogue import find_record, read_record
from warehouse.store_files import read_parquet

PROOFS, CLOUDS = "proofs", "clouds"
STATES = "states"  # the table, and its file in the folder of a model
CORRECTED = "corrected.json"  # file of a calibrated model


def diagnosis_to_record(diagnosis: Diagnosis) -> tuple[dict, dict[str, pa.Table]]:
    """Return a diagnosis as JSON and tables: what it says, and its curves."""
    # A cloud without a name is the unexplained residual of a joint.
    clouds = (*diagnosis.clouds, *diagnosis.residual_clouds)
    record = {
        "sentences": list(diagnosis.sentences),
        "notes": list(diagnosis.notes),
        "proofs": [p.id for p in diagnosis.proofs],
        "models": list(diagnosis.proofs[0].tau_hat) if diagnosis.proofs else [],
        "clouds": [[c.name, c.joint, c.variable] for c in clouds],
    }
    tables = {PROOFS: _stacked(map(_proof_columns, diagnosis.proofs))}
    columns = ("x", "residual", "fitted", "log")
    tables[CLOUDS] = _stacked({k: getattr(c, k) for k in columns} for c in clouds)
    return record, {name: t for name, t in tables.items() if t is not None}


def diagnosis_from_record(
    record: Mapping, tables: Mapping[str, pa.Table], verdict: Verdict, models: Mapping
) -> Diagnosis:
    """Return the diagnosis of a record, with its verdict and models."""
    proofs = _parts(tables.get(PROOFS), len(record["proofs"]))
    parts = _parts(tables.get(CLOUDS), len(record["clouds"]))
    clouds = [
        FindingScatter(*header, part["x"], part["residual"], part["fitted"], part["log"])
        for header, part in zip(record["clouds"], parts, strict=True)
    ]
    return Diagnosis(
        verdict=verdict,
        models=models,
        proofs=tuple(
            _proof(id, record["models"], part)
            for id, part in zip(record["proofs"], proofs, strict=True)
        ),
        clouds=tuple(c for c in clouds if c.name),
        notes=tuple(record["notes"]),
        residual_clouds=tuple(c for c in clouds if not c.name),
        sentences=tuple(record["sentences"]),
    )


def build_effect_rows(effects: Sequence[Finding]) -> Iterator[dict]:
    """Rows of the view effects: one per parameter, and per joint with its own value."""
    for effect in effects:
        common = {"order": effect.order, "name": effect.name}
        common["probability"] = effect.probability
        if not effect.parameters:
            yield common | {"joints": effect.joints}
        for key, parameter in effect.parameters.items():
            many = isinstance(parameter.value, tuple)
            places = [[j] for j in effect.joints] if many else [effect.joints]
            own = common | {"parameter": key, "unit": parameter.unit}
            for joints, (value, std) in zip(places, parameter.pairs, strict=True):
                yield own | {"joints": joints, "value": value, "std": std}


def build_error_view_rows(errors: ErrorTables) -> Iterator[dict]:
    """Rows of the view errors over all held-out runs together."""
    metrics = {
        "held_out": (errors.held_out, errors.overall),
        "filtered": (errors.filtered, errors.overall_filtered),
        "moving": (errors.moving, errors.overall_moving),
    }
    for metric, (by_joint, overall) in metrics.items():
        for stage, values in by_joint.items():
            for joint, value in enumerate(values or (), 1):
                common = {"metric": metric, "stage": stage}
                yield common | {"joint": joint, "value": value}
        for stage, value in overall.items():
            if value is not None:
                yield {"metric": metric, "stage": stage, "joint": None, "value": value}


def build_run_error_rows(diagnosis: Diagnosis) -> list[dict]:
    """Return the errors on every held-out log by itself, as rows of the view errors.

    Filtered and moving errors [%], in the words of docs/method.md section 6.
    """
    rows = []
    # Torques and forces have no sum.
    units = {diagnosis.torque_unit(j) for j in range(1, diagnosis.verdict.dof + 1)}
    for proof in diagnosis.proofs:
        samples = {"filtered": np.ones_like(proof.moving), "moving": proof.moving}
        for (stage, tau_hat), (metric, taken) in product(proof.tau_hat.items(), samples.items()):
            miss = np.where(taken, proof.tau - tau_hat, 0.0)
            power = np.where(taken, proof.tau, 0.0)
            common = {"run_id": proof.id, "stage": stage, "metric": metric}
            for joint in range(proof.tau.shape[1]):
                value = _relative(miss[:, joint], power[:, joint])
                rows.append({**common, "joint": joint + 1, "value": value})
            if len(units) == 1:
                rows.append({**common, "joint": None, "value": _relative(miss, power)})
    return [row for row in rows if row["value"] is not None]


def _relative(miss: np.ndarray, power: np.ndarray) -> float | None:
    whole = float(np.linalg.norm(power))
    return 100 * float(np.linalg.norm(miss)) / whole if whole > 0 else None


def _proof_columns(proof: LogPrediction) -> dict[str, np.ndarray]:
    columns = {"t": proof.t}
    for name, values in {"tau": proof.tau, **proof.tau_hat}.items():
        columns |= {f"{name}{j}": v for j, v in enumerate(values.T, start=1)}
    moving = enumerate(proof.moving.T, start=1)
    return columns | {f"moving{j}": v.astype(float) for j, v in moving}


def _proof(id: str, models: list[str], part: Mapping) -> LogPrediction:
    joints = range(1, 1 + sum(name.startswith("moving") for name in part))

    def of(name: str) -> np.ndarray:
        return np.column_stack([part[f"{name}{j}"] for j in joints])

    tau_hat = {name: of(name) for name in models}
    return LogPrediction(id, part["t"], of("tau"), tau_hat, of("moving") > 0)


def _stacked(parts) -> pa.Table | None:
    """Return parts stacked, distinguished by the column `part`."""
    tables = [
        pa.table({"part": np.full(len(next(iter(part.values()))), i), **part})
        for i, part in enumerate(parts)
    ]
    return pa.concat_tables(tables) if tables else None


def _parts(table: pa.Table | None, count: int) -> list[dict[str, np.ndarray]]:
    if table is None:
        return []
    columns = {name: table[name].to_numpy() for name in table.column_names}
    which = columns.pop("part")
    return [{k: v[which == i] for k, v in columns.items()} for i in range(count)]


# The motion behind a model, decimated and stored with it, for later comparisons.
#
# Runs may be pruned, or stay in the store of another site. A comparison of two epochs
# reads only motion and torque below the filters' cut-off, so these are stored with the
# model (docs/store.md: a model outlives its runs).


def build_states_table(recordings: Sequence[Recording]) -> pa.Table | None:
    """Return filtered decimated motion and torque of logs; None of no logs.

    Args:
        recordings: The logs of a model; of long ones evenly spread pieces
            are kept, 420 s in all.

    Returns:
        A row per sample: ``log`` and ``robot``, ``t`` [s], ``q`` [rad] and ``tau``
        [N m], these two as lists of single precision.
    """
    logs = [resample_recording(own, FilterSettings()) for own in pick_spread_pieces(recordings)]
    if not logs:
        return None
    count = [len(own.t) for own in logs]

    def words(values: list[str]) -> pa.Array:
        return pa.array(np.repeat(values, count).tolist()).dictionary_encode()

    def lists(parts: list[np.ndarray]) -> pa.Array:
        flat = np.concatenate(parts).astype(np.float32)
        return pa.FixedSizeListArray.from_arrays(flat.ravel(), flat.shape[1])

    columns = {
        # Pieces of one log share its name, so each also has a number.
        "log": words([f"{i}/{own.id}" for i, own in enumerate(logs)]),
        "robot": words([own.robot for own in logs]),
        "t": np.concatenate([own.t for own in logs]),
        "q": lists([own.q for own in logs]),
        "tau": lists([own.tau for own in logs]),
    }
    return pa.table(columns)


def store_outcome(
    store: Path,
    diagnosis: Diagnosis,
    runs: Mapping[str, list[str]],
    request: Mapping | None = None,
    logs: Sequence[Recording] = (),
    seconds: Mapping[str, float] | None = None,
    serial: str | None = None,
) -> tuple[str, str]:
    """Store a diagnosis, its models and its held-out validation.

    Args:
        logs: The logs behind its model, which is stored with their motion.
        seconds: Time that each step took [s].
        serial: Serial number of the arm.

    Returns:
        The ids of the diagnosis and of the validation, which has the curves.
    """
    request_entry, verdict = {"request": request}, diagnosis.verdict
    each = build_run_error_rows(diagnosis) if runs.get("held_out") else []
    models = {name: model.to_record() for name, model in diagnosis.models.items()}
    # They share one robot, stored once.
    robots = [record.pop("robot") for record in models.values()]
    content: dict = {"models": {"robot": robots[0], "models": models} if robots else {}}
    known = diagnosis.adoptable
    if known is not None and known is not diagnosis.models.get("augmented"):
        content["known"] = {"model": known.to_record()}
        del content["known"]["model"]["robot"]
    motion = build_states_table(logs)
    shown = {
        "robot": verdict.robot,
        "verdict": verdict.verdict,
        "nominal_scale": verdict.nominal_scale,
        "unexplained": verdict.unexplained.fraction,
        "document": to_json(verdict),
    }
    diagnosis_id = commit_diagnosis(
        store,
        shown | request_entry | ({"serial": serial} if serial else {}),
        request_entry | content,
        runs,
        effects=list(build_effect_rows(diagnosis.effects)),
        errors=[*build_error_view_rows(diagnosis.errors), *each],
        beside={} if motion is None else {STATES: motion},
        nominal=(request or {}).get("model"),
        seconds=seconds,
    )
    proof, curves = diagnosis_to_record(diagnosis)
    header = {"robot": verdict.robot, "kind": "held_out", "diagnosis": diagnosis_id}
    record = proof | request_entry | header
    parents = {"diagnosis": [diagnosis_id], "held_out": runs.get("held_out", [])}
    proof_id = commit_record(store, "validations", record, curves, parents)
    return diagnosis_id, proof_id


def read_outcome(store: Path, validation_id: str) -> Diagnosis:
    """Return a diagnosis as it was stored."""
    folder = find_record(store, validation_id).folder
    files = {name: folder / f"{name}.parquet" for name in (PROOFS, CLOUDS)}
    tables = {k: read_parquet(path) for k, path in files.items() if path.exists()}
    record = read_record(store, validation_id)
    id = record["diagnosis"]
    verdict, models = read_verdict(store, id), read_models(store, id)
    return diagnosis_from_record(record, tables, verdict, models)


def read_verdict(store: Path, diagnosis_id: str) -> Verdict:
    """Return the verdict of a diagnosis."""
    return parse_verdict(read_record(store, diagnosis_id).get("document"))


def read_models(store: Path, diagnosis_id: str) -> dict[str, Model | CorrectedModel]:
    """Return the models of a diagnosis, by name."""
    model_id = read_record(store, diagnosis_id)["model_id"]
    content = read_record(store, model_id).get("models")
    if not content:
        raise InputError(
            f"Diagnosis {diagnosis_id} was stored without its models. Diagnose its runs again."
        )
    return models_from_record(content)


def read_adoptable_model(store: Path, diagnosis_id: str) -> Model:
    """Return the model of a diagnosis that may be adopted."""
    record = read_record(store, read_record(store, diagnosis_id)["model_id"])
    if "known" not in record:
        return read_models(store, diagnosis_id)["augmented"]
    try:
        whole = {**record["known"]["model"], "robot": record["models"]["robot"]}
    except (KeyError, TypeError) as error:
        raise InputError(f"An adopted model is damaged: {error!r}.") from error
    return read_model(whole)


def read_motion(store: Path, diagnosis_id: str) -> tuple[Recording, ...]:
    """Return the motion behind the model of a diagnosis, by log; may be empty."""
    model = read_record(store, diagnosis_id)["model_id"]
    path = find_record(store, model).folder / f"{STATES}.parquet"
    if not path.exists():
        return ()
    table = read_parquet(path)
    names = table.column("log").to_pylist()
    robot, t = table.column("robot")[0].as_py(), table.column("t").to_numpy()
    q, tau = (
        np.stack(table.column(name).to_numpy(zero_copy_only=False)).astype(float)
        for name in ("q", "tau")
    )
    out, first = [], 0
    for name, rows in groupby(names):
        own = slice(first, first := first + len(list(rows)))
        id = name.partition("/")[2]
        out.append(Recording(id, robot, t[own], q[own], tau[own]))
    return tuple(out)


def read_runs(store: Path, diagnosis_id: str, roles: Sequence[str]) -> tuple[str, ...]:
    """Return ids of the runs of a diagnosis, role by role."""
    row = find_record(store, diagnosis_id).row
    lineage = read_parquet(row, ["lineage"]).column("lineage")[0].as_py() or []
    return tuple(p["parent"] for role in roles for p in lineage if p["role"] == role)


def models_from_record(record: Mapping) -> dict[str, Model | CorrectedModel]:
    """Return the models of a record; their robot is stored once."""
    robot = record["robot"]
    return {name: read_model({**own, "robot": robot}) for name, own in record["models"].items()}


def store_report(
    store: Path, header: Mapping[str, str], diagnosis_id: str, files: Mapping[str, bytes]
) -> Path:
    """Put the files of a report into the store."""
    parents = {"diagnosis": [diagnosis_id]}
    id = commit_record(store, "reports", header, None, parents, files)
    return build_record_path(store, "reports", id)
