"""What a page is of, and the command that makes it again: its last section."""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass

from flows.report.made import Made
from flows.requests import Diagnose
from warehouse.origin.version import version_text

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
