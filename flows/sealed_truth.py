"""Open the seals of a store for one SQL connection: `sql --truth`, and nothing else.

Diagnosing code cannot import this module (import-linter, pyproject.toml).
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import pyarrow as pa

from flows.settings import read_user_name
from residual.effects import list_effect_parameters
from residual.errors import InputError
from warehouse.queries import Store
from warehouse.record_ids import build_record_path, build_seal_path
from warehouse.remote_store import record_exists
from warehouse.store_catalogue import StoredRecord, mark_run, read_sealed_spec
from warehouse.view_schema import OPENED, TRUTH, build_arrow_schema

_RUNS = """
    SELECT run_id, robot, opened,
           run_id NOT IN (
               SELECT run_id FROM points WHERE starts_with(axis, 'plant.')) AS sealed
    FROM runs WHERE source = 'simulated' ORDER BY run_id
"""


def show_truth(opened: Store) -> None:
    """Give an open store the view truth, from the seals of all its runs.

    Each of these is marked as opened before it is read.

    Raises:
        InputError: If a seal is damaged, or the store cannot be written.
    """
    runs = [
        run
        for run in opened.sql(_RUNS).to_pylist()
        if record_exists(build_seal_path(opened.path, run["run_id"]))
    ]
    for run in runs:
        if not run["opened"]:
            mark_run(opened.path, OPENED, run["run_id"], {"by": read_user_name()})
    rows = [row for run in runs for row in _truth_rows(opened.path, run)]
    schema = build_arrow_schema(TRUTH)
    opened.show_table("truth", pa.Table.from_pylist(rows, schema=schema))


def _truth_rows(store: Path, run: Mapping) -> Iterator[dict]:
    id, units = run["run_id"], list_effect_parameters()
    folder = build_record_path(store, "runs", id, run["robot"])
    spec = read_sealed_spec(store, StoredRecord("runs", id, folder))
    try:
        for effect in spec["effects"]:
            name = effect["name"]
            common = {"run_id": id, "effect": name, "joints": effect["joints"]}
            common |= {"onset": effect["onset"], "sealed": run["sealed"]}
            for key, value in effect["parameters"] or [(None, None)]:
                unit = units.get(name, {}).get(key)
                yield common | {"parameter": key, "value": value, "unit": unit}
    except (KeyError, TypeError, ValueError) as error:
        # Without its values: anyone may read the message.
        raise InputError(
            f"The seal of run {id} has another form than expected: effects with name, "
            "joints, parameters and onset."
        ) from error
