"""A diagnosis in the store: its verdict as rows of effects, errors and lineage."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pyarrow as pa

from residual.errors import InputError
from warehouse.commit import commit_record
from warehouse.files import read_parquet
from warehouse.layout import find_run
from warehouse.schema import VIEWS, arrow_schema

# Tables of the verdict's proof, by their name as a metric; the second, where there is
# one, has all joints in one figure.
_METRICS = {
    "held_out": ("held_out", "overall"),
    "filtered": ("filtered", "overall_filtered"),
    "moving": ("moving", None),
}


def store_verdict(
    store: Path,
    verdict: Mapping,
    model_record: Mapping,
    run_ids: Sequence[str] | Mapping[str, Sequence[str]],
    more: Mapping | None = None,
    tables: Mapping[str, pa.Table] | None = None,
) -> str:
    """Put a diagnosis and its model into the store.

    Args:
        store: The store.
        verdict: The verdict in its documented form (docs/verdict.md).
        model_record: The augmented model, as JSON can hold it; ``stage`` says if it
            is another.
        run_ids: Runs that it was made from, by role: fit, baseline, held_out. Of a
            plain list those are held out that the verdict's proof names, the rest fit.
        more: What else to keep in the record, beside the verdict under "document".
        tables: Other tables of it, such as curves; rows of ``errors`` (on single runs,
            say, whose motion is filled in) are added to those of the verdict, which
            are over all held-out runs.

    Returns:
        The id of the diagnosis; the same verdict on the same runs has the same.

    Raises:
        InputError: If a run is not in the store, or something is not usable.
    """
    roles = _roles(verdict, run_ids)
    motions = {id: _trajectory(store, id) for ids in roles.values() for id in ids}
    model = {"robot": verdict["robot"], "stage": "augmented", **model_record}
    fitted = {role: ids for role, ids in roles.items() if role != "held_out"}
    model_id = commit_record(store, "models", model, parents=fitted)
    errors = list(_pooled(verdict["error"], roles.get("held_out", []), motions))
    record = {
        "robot": verdict["robot"],
        "verdict": verdict["verdict"],
        "model_id": model_id,
        "nominal_scale": verdict["nominal_scale"],
        "unexplained": (verdict["unexplained"] or {}).get("fraction"),
        "document": verdict,
        **(more or {}),
    }
    tables = dict(tables or {})
    if "errors" in tables:
        errors += [
            {**row, "trajectory": row["trajectory"] or motions.get(row["run_id"])}
            for row in tables["errors"].to_pylist()
        ]
    tables["errors"] = _table("errors", errors)
    tables["effects"] = _table("effects", list(_effect_rows(verdict["effects"])))
    parents = {**roles, "model": [model_id]}
    return commit_record(store, "diagnoses", record, tables, parents)


def _roles(verdict: Mapping, run_ids: Sequence[str] | Mapping) -> dict[str, list[str]]:
    if isinstance(run_ids, Mapping):
        return {role: list(ids) for role, ids in run_ids.items() if ids}
    held_out = set((verdict["error"] or {}).get("logs") or ())
    roles: dict[str, list[str]] = {}
    for id in run_ids:
        roles.setdefault("held_out" if id in held_out else "fit", []).append(id)
    return roles


def _trajectory(store: Path, id: str) -> str | None:
    row = read_parquet(find_run(store, id).row, ["trajectory"])
    return row.column("trajectory")[0].as_py()


def _pooled(
    error: Mapping | None, held_out: Sequence[str], motions: Mapping
) -> Iterator[dict]:
    """The verdict's errors, which are over all held-out runs together."""
    kinds = {motions[id] for id in held_out}
    same = {
        "run_id": held_out[0] if len(held_out) == 1 else None,
        "trajectory": kinds.pop() if len(kinds) == 1 else None,
    }
    for metric, (by_joint, overall) in _METRICS.items():
        row = {**same, "metric": metric}
        for stage, values in ((error or {}).get(by_joint) or {}).items():
            for joint, value in enumerate(values or (), 1):
                yield {**row, "stage": stage, "joint": joint, "value": value}
        for stage, value in ((error or {}).get(overall) or {}).items():
            if value is not None:
                yield {**row, "stage": stage, "joint": None, "value": value}


def _effect_rows(effects: Sequence[Mapping]) -> Iterator[dict]:
    """One row per parameter; of a finding with a value per joint, one for each."""
    for effect in effects:
        same = {key: effect[key] for key in ("order", "name", "probability")}
        joints = effect["joints"]
        for key, known in (effect["parameters"] or {None: {}}).items():
            row = {**same, "parameter": key, "unit": known.get("unit")}
            value, std = known.get("value"), known.get("std")
            if isinstance(value, list):
                stds = std if isinstance(std, list) else [std] * len(value)
                for joint, one, spread in zip(joints, value, stds, strict=True):
                    yield {**row, "joints": [joint], "value": one, "std": spread}
            else:
                yield {**row, "joints": joints, "value": value, "std": std}


def _table(view: str, rows: list[dict]) -> pa.Table:
    schema = arrow_schema(VIEWS[view][1:])
    try:
        return pa.Table.from_pylist(rows, schema=schema)
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise InputError(
            f"The verdict does not fit the view {view}: {error}"
        ) from error
