"""Where a record and a page about it come from, and what makes them again."""

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from flows.requests import Diagnose
from warehouse.files import read_parquet
from warehouse.layout import find
from warehouse.provenance import version_text

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


Fact = tuple[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a page comes from.

    Attributes:
        facts: What it is, and its values: ids and names of files.
        program: Version and commit of the program.
        command: What makes the page again; empty where nothing does.
    """

    facts: tuple[Fact, ...]
    program: str
    command: str


def of_request(request: Diagnose, page: str = "report.html") -> Origin:
    """Return the origin of a diagnosis that was just made."""
    facts: list[Fact] = [("Robot", (request.robot,)), ("Logs", request.logs)]
    facts += [("Baseline", request.baseline)] if request.baseline else []
    facts += [("Held out", request.held_out)] if request.held_out else []
    model = request.model or "as the robot is described"
    facts.append(("Nominal model", (model,)))
    return Origin(tuple(facts), version_text(), command(request, page))


def of_record(made: Made, record: Mapping) -> Origin:
    """Return the origin of a diagnosis in the store."""
    facts: list[Fact] = [
        ("Diagnosis", (made.id,)),
        ("Stored", (f"{made.created} UTC",)),
    ]
    facts += [(role.capitalize(), ids) for role, ids in made.data.items()]
    program = " ".join(["modelgap", made.version or ""]).strip()
    if made.commit:
        program += f", commit {made.commit}"
        program += " with changes that were not committed" if made.changed else ""
    asked = record.get("request")
    again = made.command
    if asked:
        again = command(Diagnose.from_record(asked, None), "report.html")
    return Origin(tuple(facts), program, again)


def command(request: Diagnose, page: str) -> str:
    """Return the command line of a diagnosis with its page."""
    words = ["modelgap", "diagnose", *request.logs, "--robot", request.robot]
    for option, values in (
        ("--holdout", request.held_out),
        ("--baseline", request.baseline),
        ("--known", request.known),
    ):
        words += [word for value in values for word in (option, value)]
    if request.declared is not None:
        words += ["--declared", ",".join(request.declared) or "none"]
    for option, value in (
        ("--map", request.columns),
        ("--null", request.null),
        ("--model", request.model),
        ("--store", request.store),
    ):
        words += [option, str(value)] if value else []
    words += ["--trust-log"] if request.trust_log else []
    return shlex.join([*words, "--report", page])
