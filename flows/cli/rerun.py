"""modelgap rerun: a record made again, and whether it is the same."""

import json
from typing import Literal

from flows.cli.options import Flag
from flows.errors import RunError
from flows.report.records import rerun_lines, rerun_record
from flows.settings import store_folder
from flows.steps.rerun import rerun as steps


def rerun(
    id: str,
    /,
    *,
    verify: Flag = False,
    format: Literal["text", "json"] = "text",
    store: str | None = None,
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
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    place = store_folder(store)
    made = steps.rerun(id, place, verify)
    if format == "json":
        print(json.dumps(rerun_record(made), indent=2, ensure_ascii=False))
    else:
        print("\n".join(rerun_lines(made)))
    if not made.reproduced and (verify or made.same_code):
        raise RunError(f"{made.kind} {made.id} was not reproduced.")
