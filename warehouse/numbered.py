"""Numbered records that are never changed: which model a robot has, what a loop did.

A number can be taken only once, since its folder is renamed into place; whoever comes
second is told of the first. Of the adoptions of a robot the last one holds; rolling
back is one more, which names the model of before. The decisions of a loop are its whole
memory: it goes on from them after any kill.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from residual.errors import InputError
from warehouse import ids
from warehouse.commit import commit_row, lineage_rows
from warehouse.files import read_cell
from warehouse.ids import record_folder
from warehouse.layout import list_folders
from warehouse.mirror import is_there
from warehouse.schema import KINDS

ADOPTIONS, DECISIONS = "adoptions", "decisions"
ADOPTED, FORCED, ROLLED_BACK = "adopted", "forced", "rolled back"
_DIGITS = 6


class MeanwhileError(InputError):
    """Somebody else has given the robot a model meanwhile."""


@dataclass(frozen=True, slots=True)
class Adoption:
    """A robot gets a model."""

    robot: str
    serial: str | None  # its serial number, None where it has none
    action: str  # "adopted", "forced" or "rolled back"
    model_id: str | None  # id of the model, None for the nominal one
    diagnosis_id: str | None  # id of the diagnosis that found it
    parent: str | None  # id of the adoption before it, None for the first
    who: str  # name of the user
    note: str = ""  # what he wrote about it
    # Held-out error of the model before and of this one [%].
    before: float | None = None
    after: float | None = None
    evidence: Mapping | None = None  # everything that the gate saw


@dataclass(frozen=True, slots=True)
class Decision:
    """One step of a loop: what was done, why, and what came of it."""

    loop: str  # id of the loop
    number: int  # its place in the loop, from 1
    robot: str  # slug of the arm
    serial: str | None  # its serial number, None where it has none
    action: str  # run, diagnose, adopt, drive or stop
    reason: str
    outcome: str  # what came of it, in a few words
    made: str | None = None  # id of the record that it left in the store, None for none
    seconds: float = 0.0  # motion of the arm so far, this step included [s]
    # What later steps go by, as JSON can hold it.
    result: Mapping = field(default_factory=dict)


def commit_adoption(store: Path, adoption: Adoption) -> str:
    """Put an adoption into the store under the next number.

    Args:
        adoption: Its parent is what the robot had when it was judged.

    Raises:
        MeanwhileError: If the robot has got another model since.
    """
    ids.check_slug(adoption.robot)
    parents = {"model": [adoption.model_id], "diagnosis": [adoption.diagnosis_id]}
    lineage = lineage_rows({k: given for k, given in parents.items() if given[0]})
    while True:
        numbers = list_folders(store, ADOPTIONS)
        _check_parent(store, adoption)
        id = f"{1 + max(map(int, numbers), default=0):0{_DIGITS}}"
        # Of two with one number one is told no, and looks again who was faster.
        if commit_row(store, ADOPTIONS, id, asdict(adoption), {"lineage": lineage}):
            return id


def read_adoption(store: Path, id: str) -> Adoption:
    """Return an adoption."""
    return _read(Adoption, record_folder(store, ADOPTIONS, id), ADOPTIONS)


def adopted(
    store: Path, robot: str, serial: str | None = None
) -> tuple[str, Adoption] | None:
    """Return the last adoption of a robot with its number, None where there is none."""
    for id in sorted(list_folders(store, ADOPTIONS), reverse=True):
        found = read_adoption(store, id)
        if (found.robot, found.serial) == (robot, serial):
            return id, found
    return None


def commit_decision(store: Path, decision: Decision) -> str:
    """Put a decision into the store; its number is the next one of its loop.

    Raises:
        InputError: If that number is taken: the same loop runs elsewhere, too.
    """
    id = ids.decision_id(decision.loop, decision.number)
    parents = {decision.action: [decision.made]} if decision.made else {}
    record, lists = ids.plain(decision), {"lineage": lineage_rows(parents)}
    if not commit_row(store, DECISIONS, id, record, lists):
        raise InputError(
            f"Decision {decision.number} of loop {decision.loop} is there already: "
            "the same loop runs in another process. Let that one go on."
        )
    return id


def read_decisions(store: Path, loop: str) -> tuple[Decision, ...]:
    """Return what a loop has decided so far, the first one first."""
    found: list[Decision] = []
    while True:
        id = ids.decision_id(loop, len(found) + 1)
        folder = record_folder(store, DECISIONS, id)
        if not is_there(folder):
            return tuple(found)
        found.append(_read(Decision, folder, DECISIONS))


def _read(form: type, folder: Path, kind: str) -> Any:
    """Return a record of one of the two forms; what else is in it is left out."""
    record = json.loads(read_cell(folder / KINDS[kind].row, "record"))
    return form(**{each.name: record[each.name] for each in fields(form)})


def _check_parent(store: Path, adoption: Adoption) -> None:
    last = adopted(store, adoption.robot, adoption.serial)
    if (last[0] if last else None) == adoption.parent:
        return
    id, other = last
    raise MeanwhileError(
        f"{other.who} has given {adoption.robot} another model meanwhile (adoption "
        f"{int(id)}: {other.action} {other.model_id or 'the nominal model'}). Nothing "
        "was changed. Look at it with modelgap models, and try again if it still holds."
    )
