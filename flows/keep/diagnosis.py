"""A diagnosis and its report as records of the store."""

from collections.abc import Mapping
from pathlib import Path

from flows.keep.diagnosis_tables import (
    CLOUDS,
    PROOFS,
    errors_by_run,
    from_record,
    to_record,
)
from residual.diagnosis.result import Outcome
from warehouse.commit import commit_record, read_record
from warehouse.files import read_parquet
from warehouse.layout import find, record_folder
from warehouse.verdicts import store_verdict

_OF_MODEL = ("name", "joints", "parameters")


def store_outcome(
    store: Path,
    outcome: Outcome,
    runs: Mapping[str, list[str]],
    request: Mapping | None = None,
) -> tuple[str, str]:
    """Put a diagnosis and the proof of it into the store.

    Args:
        store: The store.
        outcome: The diagnosis.
        runs: Ids of the runs it is from, by role.
        request: What was asked for, so that it can be made again.

    Returns:
        The ids of the diagnosis and of the validation, which has the curves.
    """
    verdict, asked = outcome.verdict, {"request": request}
    model = {
        **asked,
        "declared": verdict["declared"],
        "effects": [{k: effect[k] for k in _OF_MODEL} for effect in verdict["effects"]],
    }
    each = {"errors": errors_by_run(outcome)} if runs.get("held_out") else None
    diagnosis_id = store_verdict(store, verdict, model, runs, asked, each)
    told, curves = to_record(outcome)
    record = told | asked | {"robot": verdict["robot"], "kind": "held_out"}
    parents = {
        "diagnosis": [diagnosis_id],
        "held_out": runs.get("held_out", []),
    }
    proof_id = commit_record(store, "validations", record, curves, parents)
    return diagnosis_id, proof_id


def read_outcome(store: Path, validation_id: str) -> Outcome:
    """Return a diagnosis as it was stored.

    Args:
        store: The store.
        validation_id: Id of the validation that `store_outcome` made.

    Raises:
        InputError: If there is none of that id, or it is damaged.
    """
    folder = find(store, validation_id).folder
    files = {name: folder / f"{name}.parquet" for name in (PROOFS, CLOUDS)}
    tables = {k: read_parquet(path) for k, path in files.items() if path.exists()}
    return from_record(read_record(store, validation_id), tables)


def store_report(
    store: Path, about: Mapping[str, str], diagnosis_id: str, files: Mapping[str, bytes]
) -> Path:
    """Put the files of a report into the store.

    Args:
        store: The store.
        about: `robot`, and `kind`: what it reports, such as "demo".
        diagnosis_id: The diagnosis that it shows.
        files: Content by file name.

    Returns:
        The folder with the files.
    """
    parents = {"diagnosis": [diagnosis_id]}
    id = commit_record(store, "reports", about, None, parents, files)
    return record_folder(store, "reports", id)
