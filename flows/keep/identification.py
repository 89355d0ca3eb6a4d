"""What was identified as a record of the store: parameters and errors as rows."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pyarrow as pa

from flows.keep.identification_json import KINDS, document
from residual.identification.prove import Identified
from residual.model.record import to_record
from warehouse.commit import commit_record
from warehouse.schema import VIEWS, arrow_schema

STAGE = "identified"
# What the figures of the document are called in the view errors.
_METRICS = {"raw": "held_out", "filtered": "filtered", "moving": "moving"}


def store_identification(
    store: Path,
    outcome: Identified,
    request: Mapping,
    runs: Mapping[str, Sequence[str]],
) -> str:
    """Put an identified model into the store.

    Args:
        request: What was asked for, so that it can be made again.

    Returns:
        The id of the model; the same model of the same runs has the same.
    """
    told = document(outcome)
    record = {
        "robot": outcome.robot.name,
        "stage": STAGE,
        "request": request,
        "document": told,
        "model": to_record(outcome.found.model),
    }
    held_out = runs.get("held_out") or runs.get("fit") or ()
    one = held_out[0] if len(held_out) == 1 and not outcome.same_run else None
    tables = {
        "parameters": _table("parameters", _parameters(told)),
        "errors": _table("errors", list(_errors(told, one))),
    }
    return commit_record(store, "models", record, tables, runs)


def _parameters(told: Mapping) -> list[dict]:
    return [{**one, "std": one["sd"]} for one in told["parameters"]]


def _errors(told: Mapping, run_id: str | None) -> Iterator[dict]:
    same = {"run_id": run_id, "trajectory": None}
    for kind in KINDS:
        for stage, error in told["error"][kind].items():
            row = {**same, "stage": stage, "metric": _METRICS[kind]}
            values = enumerate(error["joints"], 1)
            for joint, value in (*values, (None, error["overall"])):
                if value is not None:
                    yield {**row, "joint": joint, "value": value}


def _table(view: str, rows: list[dict]) -> pa.Table:
    return pa.Table.from_pylist(rows, schema=arrow_schema(VIEWS[view][1:]))
