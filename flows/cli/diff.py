"""modelgap diff and lineage: two records side by side, and a record's relatives."""

import json
from dataclasses import asdict
from typing import Literal

from rich.console import Console

from flows.cli.options import Flag
from flows.report.console import show, wide
from flows.report.records import as_record, comparison, print_tree
from flows.settings import store_folder
from flows.steps import diff as steps
from warehouse.lineage import tree
from warehouse.query.store import open_store

Shown = Literal["table", "json"]


def diff(
    one: str, two: str, /, *, format: Shown = "table", store: str | None = None
) -> None:
    """Compare two runs, models, diagnoses or validations.

    ```
    modelgap diff 3f2a 77c0
    modelgap diff 3f2a 77c0 --format json
    ```

    Spec, code, environment, and the values: of runs channel by channel, from which time
    on and how far they differ; of others value by value.

    Args:
        one: Id of a record; the beginning is enough.
        two: Id of another record of the same kind.
        format: How to print it.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    found = steps.diff(one, two, store_folder(store))
    if format == "json":
        print(json.dumps(as_record(found), indent=2, ensure_ascii=False))
    else:
        show(wide(Console(), 1000), *comparison(found))


def lineage(
    id: str,
    /,
    *,
    up: Flag = False,
    down: Flag = False,
    format: Shown = "table",
    store: str | None = None,
) -> None:
    """Show what a record was made from, and what was made from it, all the way.

    ```
    modelgap lineage 3f2a
    modelgap lineage 3f2a --down
    ```

    Args:
        id: Its id; the beginning is enough.
        up: Only what it was made from.
        down: Only what was made from it.
        format: How to print it.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    wanted = {"made from": up or not down, "gave": down or not up}
    with open_store(store_folder(store)) as opened:
        trees = {
            words: tree(opened, id, words == "gave")
            for words, asked in wanted.items()
            if asked
        }
    if format == "json":
        told = {words: asdict(root) for words, root in trees.items()}
        print(json.dumps(told, indent=2))
        return
    for words, root in trees.items():
        print_tree(root, words, wide(Console(), 1000))
