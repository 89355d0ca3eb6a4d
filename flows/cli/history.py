"""modelgap diff, lineage and rerun: where a record comes from."""

import json
from dataclasses import asdict
from typing import Literal

from rich.console import Console

from flows.report.console import show, wide
from flows.report.records import (
    as_record,
    comparison,
    print_tree,
    rerun_lines,
    rerun_record,
)
from flows.requests import Flag, Store
from flows.settings import store_folder
from flows.steps import diff as steps
from flows.steps import rerun as reruns
from residual.errors import RunError
from warehouse.query.lineage import lineage_tree
from warehouse.query.store import open_store

Shown = Literal["table", "json"]


def diff(
    one: str, two: str, /, *, format: Shown = "table", store: Store = None
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
    store: Store = None,
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
    """
    directions = {"made from": up or not down, "gave": down or not up}
    with open_store(store_folder(store)) as opened:
        trees = {
            words: lineage_tree(opened, id, words == "gave")
            for words, asked in directions.items()
            if asked
        }
    if format == "json":
        document = {words: asdict(root) for words, root in trees.items()}
        print(json.dumps(document, indent=2))
        return
    for words, root in trees.items():
        print_tree(root, words, wide(Console(), 1000))


def rerun(
    id: str,
    /,
    *,
    verify: Flag = False,
    format: Literal["text", "json"] = "text",
    store: Store = None,
) -> None:
    """Make a run, model, diagnosis or validation again, and compare bit for bit.

    ```
    modelgap rerun 3f2a --verify
    modelgap rerun 3f2a
    ```

    A simulated run is made from its spec and its sealed half, other records from what
    was asked for and the records they were made from. Where values differ, it is said
    which, from when on, how far, and from which cause: code, environment, machine,
    seed or spec, damage, or none of these (docs/reproducibility.md).

    With the same code nothing new is stored. With other code the new record is, the
    first one as its parent. That values differ is kept on record:
    modelgap sql --named reruns_not_reproduced.

    Exit code: with --verify 1 where a value differs; without it, 1 where one differs
    although the code is the same.

    Args:
        id: Its id; the beginning is enough.
        verify: Only compare, store nothing. A measured run, which cannot be made again,
            is checked against the hash of its values.
        format: How to print the outcome.
    """
    place = store_folder(store)
    made = reruns.rerun(id, place, verify)
    if format == "json":
        print(json.dumps(rerun_record(made), indent=2, ensure_ascii=False))
    else:
        print("\n".join(rerun_lines(made)))
    if not made.reproduced and (verify or made.same_code):
        raise RunError(f"{made.kind} {made.id} was not reproduced.")
