"""A diagnosis as rows and tables: its report can be made from the store."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np
import pyarrow as pa

from residual.diagnosis.result import Diagnosis, ErrorTables, Finding, Verdict
from residual.model.compare import Cloud, LogProof

PROOFS, CLOUDS = "proofs", "clouds"


def to_record(found: Diagnosis) -> tuple[dict, dict[str, pa.Table]]:
    """Return a diagnosis as JSON and tables: what it says, and its curves.

    Args:
        found: The diagnosis; its verdict and models are kept elsewhere.
    """
    # A cloud without a name is what a joint keeps.
    clouds = (*found.clouds, *found.left)
    record = {
        "sentences": list(found.sentences),
        "notes": list(found.notes),
        "proofs": [p.id for p in found.proofs],
        "models": list(found.proofs[0].tau_hat) if found.proofs else [],
        "clouds": [[c.name, c.joint, c.variable] for c in clouds],
    }
    tables = {PROOFS: _stacked(map(_proof_columns, found.proofs))}
    tables[CLOUDS] = _stacked(map(_cloud_columns, clouds))
    return record, {name: t for name, t in tables.items() if t is not None}


def from_record(
    record: Mapping, tables: Mapping[str, pa.Table], verdict: Verdict, models: Mapping
) -> Diagnosis:
    """Return the diagnosis that `to_record` was given, with its verdict and models."""
    proofs = _parts(tables.get(PROOFS), len(record["proofs"]))
    parts = _parts(tables.get(CLOUDS), len(record["clouds"]))
    clouds = [
        Cloud(*about, part["x"], part["residual"], part["fitted"], part["log"])
        for about, part in zip(record["clouds"], parts, strict=True)
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
        left=tuple(c for c in clouds if not c.name),
        sentences=tuple(record["sentences"]),
    )


def effect_rows(effects: Sequence[Finding]) -> Iterator[dict]:
    """Rows of the view effects: one per parameter, and per joint with its own value."""
    for effect in effects:
        same = {"order": effect.order, "name": effect.name}
        same["probability"] = effect.probability
        if not effect.parameters:
            yield same | {"joints": effect.joints}
        for key, parameter in effect.parameters.items():
            many = isinstance(parameter.value, tuple)
            places = [[j] for j in effect.joints] if many else [effect.joints]
            own = same | {"parameter": key, "unit": parameter.unit}
            for joints, (value, std) in zip(places, parameter.pairs, strict=True):
                yield own | {"joints": joints, "value": value, "std": std}


def error_rows(errors: ErrorTables) -> Iterator[dict]:
    """Rows of the view errors that are over all held-out runs together."""
    metrics = {
        "held_out": (errors.held_out, errors.overall),
        "filtered": (errors.filtered, errors.overall_filtered),
        "moving": (errors.moving, errors.overall_moving),
    }
    for metric, (by_joint, overall) in metrics.items():
        for stage, values in by_joint.items():
            for joint, value in enumerate(values or (), 1):
                same = {"metric": metric, "stage": stage}
                yield same | {"joint": joint, "value": value}
        for stage, value in overall.items():
            if value is not None:
                yield {"metric": metric, "stage": stage, "joint": None, "value": value}


def errors_by_run(found: Diagnosis) -> list[dict]:
    """Return the errors on every held-out log by itself, as rows of the view errors.

    Filtered and moving errors [%], in the words of docs/method.md section 6.
    """
    rows = []
    for proof in found.proofs:
        samples = {"filtered": np.ones_like(proof.moving), "moving": proof.moving}
        for (stage, tau_hat), (metric, taken) in product(
            proof.tau_hat.items(), samples.items()
        ):
            miss = np.where(taken, proof.tau - tau_hat, 0.0)
            power = np.where(taken, proof.tau, 0.0)
            same = {"run_id": proof.id, "stage": stage, "metric": metric}
            for joint in range(proof.tau.shape[1]):
                value = _relative(miss[:, joint], power[:, joint])
                rows.append({**same, "joint": joint + 1, "value": value})
            rows.append({**same, "joint": None, "value": _relative(miss, power)})
    return [row for row in rows if row["value"] is not None]


def _relative(miss: np.ndarray, power: np.ndarray) -> float | None:
    whole = float(np.linalg.norm(power))
    return 100 * float(np.linalg.norm(miss)) / whole if whole > 0 else None


def _proof_columns(proof: LogProof) -> dict[str, np.ndarray]:
    columns = {"t": proof.t}
    for name, values in {"tau": proof.tau, **proof.tau_hat}.items():
        columns |= {f"{name}{j}": v for j, v in enumerate(values.T, start=1)}
    moving = enumerate(proof.moving.T, start=1)
    return columns | {f"moving{j}": v.astype(float) for j, v in moving}


def _proof(id: str, models: list[str], part: Mapping) -> LogProof:
    joints = range(1, 1 + sum(name.startswith("moving") for name in part))

    def of(name: str) -> np.ndarray:
        return np.column_stack([part[f"{name}{j}"] for j in joints])

    tau_hat = {name: of(name) for name in models}
    return LogProof(id, part["t"], of("tau"), tau_hat, of("moving") > 0)


def _cloud_columns(cloud: Cloud) -> dict[str, np.ndarray]:
    return {
        "x": cloud.x,
        "residual": cloud.residual,
        "fitted": cloud.fitted,
        "log": cloud.log,
    }


def _stacked(parts) -> pa.Table | None:
    """Return parts under each other, told apart by the column `part`."""
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
