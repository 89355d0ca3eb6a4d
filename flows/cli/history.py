"""modelgap diff, lineage, rerun, bundle and unbundle: where a record comes from."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Literal

from rich.console import Console

from flows.outputs import check_outside
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
from warehouse.bundle import read_bundle, write_bundle
from warehouse.mirror import shown
from warehouse.query.lineage import tree
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
            words: tree(opened, id, words == "gave")
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


def bundle(
    id: str,
    /,
    *,
    out: str,
    without_seal: Flag = False,
    store: Store = None,
) -> None:
    """Write a record with all that it was made from into one file.

    ```
    modelgap bundle 3f2a --out run.tar
    ```

    On the other machine, with this program at the same commit:

    ```
    modelgap unbundle run.tar --store there
    modelgap rerun 3f2a --verify --store there
    ```

    The sealed halves of simulated runs are in it: without them no run can be made
    again, with them its reader can look at what was hidden.

    Args:
        id: Its id; the beginning is enough.
        out: The file to write; its name ends in .tar.
        without_seal: Leave out what simulated runs hide.
    """
    place = store_folder(store)
    check_outside("--out", out, place)
    made = write_bundle(place, id, Path(out), not without_seal)
    for kind, each in made.records:
        print(f"{kind:12} {each}")
    print(f"wrote {out}, {made.size / 1e6:.1f} MB")
    if made.seals:
        print("It has sealed halves: its reader can look at what was hidden.")
    if made.changes:
        print("It has uncommitted changes of the code, as a patch.")
    if made.left_out:
        print(
            f"{made.left_out} sealed halves were left out: those runs cannot be made "
            "again from it."
        )


def unbundle(file: str, /, *, store: Store = None) -> None:
    """Add the records of a bundle to a store.

    ```
    modelgap unbundle run.tar --store there
    ```

    Paths, sizes and hashes are checked, and that each record is what its id says,
    before any of it is in the store. A record that is there already is left as it is.

    Args:
        file: A file that modelgap bundle wrote.
    """
    place = store_folder(store)
    done = read_bundle(Path(file), place)
    for path in done.added:
        print(f"added   {path}")
    for path in done.known:
        print(f"is there {path}")
    print(f"{len(done.added)} added to {shown(place)}: modelgap show {done.about[:8]}")
