"""modelgap diff, lineage and rerun."""

import json
from dataclasses import asdict

from rich.console import Console

from flows.requests import Flag, Store, TableFormat, TextFormat
from flows.settings import resolve_store_folder
from residual.errors import RunError


def diff(one: str, two: str, /, *, format: TableFormat = "table", store: Store = None) -> None:
    """Compare two runs, models, diagnoses or validations.

    ```
    modelgap diff 3f2a 77c0
    modelgap diff 3f2a 77c0 --format json
    ```

    Compares spec, code, environment and values; of runs each channel, with the time
    and the size of the difference.

    Args:
        one: Id of a record, or its beginning.
        two: Id of a second record of the same kind.
        format: Format of the output.
    """
    from flows.report.document import print_parts, widen_piped_console
    from flows.report.records import build_diff_record, build_diff_tables
    from flows.steps import diff as steps

    difference = steps.diff_records(one, two, resolve_store_folder(store))
    if format == "json":
        print(json.dumps(build_diff_record(difference), indent=2, ensure_ascii=False))
    else:
        print_parts(widen_piped_console(Console(), 1000), *build_diff_tables(difference))


def lineage(
    id: str,
    /,
    *,
    up: Flag = False,
    down: Flag = False,
    format: TableFormat = "table",
    store: Store = None,
) -> None:
    """Show the sources of a record, and the records made from it.

    ```
    modelgap lineage 3f2a
    modelgap lineage 3f2a --down
    ```

    Args:
        id: Id of the record, or its beginning.
        up: Only the sources.
        down: Only the records made from it.
        format: Format of the output.
    """
    from flows.report.document import widen_piped_console
    from flows.report.records import print_tree
    from warehouse.query.store import build_lineage_tree, open_store

    directions = {"made from": up or not down, "gave": down or not up}
    with open_store(resolve_store_folder(store)) as opened:
        trees = {
            words: build_lineage_tree(opened, id, words == "gave")
            for words, shown in directions.items()
            if shown
        }
    if format == "json":
        document = {words: asdict(root) for words, root in trees.items()}
        print(json.dumps(document, indent=2))
        return
    for words, root in trees.items():
        print_tree(root, words, widen_piped_console(Console(), 1000))


def rerun(
    id: str, /, *, verify: Flag = False, format: TextFormat = "text", store: Store = None
) -> None:
    """Repeat a run, model, diagnosis or validation, and compare bit for bit.

    ```
    modelgap rerun 3f2a --verify
    modelgap rerun 3f2a
    ```

    A simulated run is repeated from its spec and its sealed half, another record from
    its request and its sources. For values that differ it prints which, from when, by
    how much and the likely cause: code, environment, machine, seed or spec, or damage
    (docs/reproducibility.md).

    With the same code nothing is stored; with other code the new record is stored, with
    the first one as its parent. Differences are stored: modelgap sql --named
    reruns_not_reproduced.

    Exit code 1: with --verify, a value differs; without it, a value differs although
    the code is the same.

    Args:
        id: Id of the record, or its beginning.
        verify: Only compare, store nothing. A measured run is checked against the hash
            of its values.
        format: Format of the output.
    """
    from flows.report.records import build_rerun_record, describe_rerun
    from flows.steps import rerun as reruns

    place = resolve_store_folder(store)
    outcome = reruns.rerun(id, place, verify)
    if format == "json":
        print(json.dumps(build_rerun_record(outcome), indent=2, ensure_ascii=False))
    else:
        print("\n".join(describe_rerun(outcome)))
    if not outcome.reproduced and (verify or outcome.same_code):
        raise RunError(f"{outcome.kind} {outcome.id} was not reproduced.")
