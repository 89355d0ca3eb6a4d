"""Numbered records that are never changed: which model a robot has.

A number can be taken only once, since its folder is renamed into place; whoever comes
second is told of the first. Of the adoptions of a robot the last one holds; rolling
back is one more, which names the model of before.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from residual.errors import InputError
from warehouse import ids
from warehouse.commit import commit_row, lineage_rows
from warehouse.files import read_cell
from warehouse.ids import record_folder
from warehouse.layout import list_folders
from warehouse.schema import KINDS

ADOPTIONS = "adoptions"
ADOPTED, FORCED, ROLLED_BACK = "adopted", "forced", "rolled back"
_DIGITS = 6


class AdoptionConflictError(InputError):
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


def commit_adoption(store: Path, adoption: Adoption) -> str:
    """Put an adoption into the store under the next number.

    Args:
        adoption: Its parent is what the robot had when it was judged.

    Raises:
        AdoptionConflictError: If the robot has got another model since.
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
    """Return an adoption; what else is in its record is left out."""
    row = record_folder(store, ADOPTIONS, id) / KINDS[ADOPTIONS].row
    record = json.loads(read_cell(row, "record"))
    return Adoption(**{each.name: record[each.name] for each in fields(Adoption)})


def adopted(
    store: Path, robot: str, serial: str | None = None
) -> tuple[str, Adoption] | None:
    """Return the last adoption of a robot with its number, None where there is none."""
    for id in sorted(list_folders(store, ADOPTIONS), reverse=True):
        found = read_adoption(store, id)
        if (found.robot, found.serial) == (robot, serial):
            return id, found
    return None


def _check_parent(store: Path, adoption: Adoption) -> None:
    last = adopted(store, adoption.robot, adoption.serial)
    if (last[0] if last else None) == adoption.parent:
        return
    id, other = last
    raise AdoptionConflictError(
        f"{other.who} has given {adoption.robot} another model meanwhile (adoption "
        f"{int(id)}: {other.action} {other.model_id or 'the nominal model'}). Nothing "
        "was changed. Look at it with modelgap models, and try again if it still holds."
    )
