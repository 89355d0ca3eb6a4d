"""Where a record comes from, for the foot of every page about it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from warehouse.files import read_parquet
from warehouse.layout import find

_SHORT = 12  # digits of a commit that people read


@dataclass(frozen=True, slots=True)
class Made:
    """Where a record comes from.

    Attributes:
        what: Its kind in the singular, such as "diagnosis".
        id: Its id.
        created: When it was committed, ISO 8601 to the second, UTC.
        version: Version of the program that made it; None where it was not noted.
        commit: Commit in git of that program, its beginning; None for no checkout.
        changed: Whether the program had changes that were not committed.
        data: Ids that it was made from by role, such as fit, held_out and model.
        command: What makes it again and compares it.
    """

    what: str
    id: str
    created: str
    version: str | None
    commit: str | None
    changed: bool
    data: Mapping[str, tuple[str, ...]]
    command: str


_KINDS = {
    "runs": "run",
    "models": "model",
    "diagnoses": "diagnosis",
    "validations": "validation",
    "reports": "report",
    "adoptions": "adoption",
}


def made_of(store: Path, id: str) -> Made:
    """Return where a record of a store comes from.

    Raises:
        InputError: If there is no such record, or it is damaged.
    """
    found = find(store, id)
    is_run = found.kind == "runs"
    columns = ["created", "lineage", "manifest" if is_run else "provenance"]
    row = read_parquet(found.row, columns).to_pylist()[0]
    known = json.loads(row[columns[-1]])
    known = (known.get("provenance") if is_run else known) or {}
    data: dict[str, tuple[str, ...]] = {}
    for parent in row["lineage"] or ():
        role = parent["role"].replace("_", " ")
        data[role] = (*data.get(role, ()), parent["parent"])
    again = "show" if found.kind in ("reports", "adoptions") else "rerun"
    return Made(
        what=_KINDS[found.kind],
        id=found.id,
        created=f"{row['created']:%Y-%m-%d %H:%M:%S}",
        version=(known.get("versions") or {}).get("modelgap"),
        commit=(known.get("commit") or "")[:_SHORT] or None,
        changed=bool(known.get("dirty")),
        data=data,
        command=f"modelgap {again} {found.id}",
    )
