"""A diagnosis in the store: its model, and rows of effects, errors and lineage."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa

from residual.errors import InputError
from warehouse.commit import commit_record
from warehouse.files import read_parquet
from warehouse.layout import find_run
from warehouse.schema import VIEWS, arrow_schema


@dataclass(frozen=True, eq=False, slots=True)
class Rows:
    """What is kept of a diagnosis.

    Attributes:
        record: Its record as JSON can hold it; with ``robot``, and what else the view
            diagnoses shows, but for ``model_id``.
        model: The record of the model it ends with; ``stage`` says if it is another
            than augmented.
        effects: Rows of the view effects.
        errors: Rows of the view errors, but for ``trajectory``; those without a
            ``run_id`` are over all held-out runs.
        tables: Other tables of it, such as curves.
        beside: Tables that go with its model: the motion that it is from.
        nominal: Id of the diagnosis whose model was the nominal one, if any.
    """

    record: Mapping
    model: Mapping
    effects: Sequence[Mapping] = ()
    errors: Sequence[Mapping] = ()
    tables: Mapping[str, pa.Table] = field(default_factory=dict)
    nominal: str | None = None
    beside: Mapping[str, pa.Table] = field(default_factory=dict)


def store_rows(store: Path, rows: Rows, runs: Mapping[str, Sequence[str]]) -> str:
    """Put a diagnosis and its model into the store.

    Args:
        runs: Ids of the runs that it was made from, by role: fit, baseline, held_out.

    Returns:
        The id of the diagnosis; the same one on the same runs has the same.
    """
    roles = {role: list(ids) for role, ids in runs.items() if ids}
    motions = {id: _trajectory(store, id) for ids in roles.values() for id in ids}
    model = {"robot": rows.record["robot"], "stage": "augmented", **rows.model}
    before = {"nominal": [rows.nominal]} if rows.nominal else {}
    fitted = {role: ids for role, ids in roles.items() if role != "held_out"} | before
    model_id = commit_record(store, "models", model, rows.beside, fitted)
    errors = _placed(rows.errors, roles.get("held_out", []), motions)
    tables = {
        **rows.tables,
        "errors": _table("errors", errors),
        "effects": _table("effects", rows.effects),
    }
    record = {**rows.record, "model_id": model_id}
    parents = {**roles, **before, "model": [model_id]}
    return commit_record(store, "diagnoses", record, tables, parents)


def _trajectory(store: Path, id: str) -> str | None:
    row = read_parquet(find_run(store, id).row, ["trajectory"])
    return row.column("trajectory")[0].as_py()


def _placed(
    errors: Sequence[Mapping], held_out: Sequence[str], motions: Mapping
) -> list[dict]:
    """Fill in the motion; what is over one held-out run, or one motion, is of it."""
    kinds = {motions[id] for id in held_out}
    same = {
        "run_id": held_out[0] if len(held_out) == 1 else None,
        "trajectory": kinds.pop() if len(kinds) == 1 else None,
    }
    return [
        {**row, "trajectory": motions.get(row["run_id"])}
        if row.get("run_id")
        else {**row, **same}
        for row in errors
    ]


def _table(view: str, rows: Sequence[Mapping]) -> pa.Table:
    schema = arrow_schema(VIEWS[view][1:])
    try:
        return pa.Table.from_pylist(list(rows), schema=schema)
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise InputError(
            f"The diagnosis does not fit the view {view}: {error}"
        ) from error
