"""Which model a robot has: numbered records, of which the last one holds.

A record is never changed: rolling back is one more, which names the model of before. A
number can be taken only once, since its folder is renamed into place; whoever comes
second with a model for the same robot is told of the first.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from residual.errors import InputError
from warehouse.commit import one_row, row_of
from warehouse.files import publish, read_parquet, staged, write_parquet
from warehouse.ids import check_slug
from warehouse.kinds import KINDS
from warehouse.layout import list_folders, record_folder
from warehouse.origin.made_with import keep_made_with
from warehouse.origin.provenance import as_record, provenance
from warehouse.query.catalogue import remember
from warehouse.runs import lineage_rows

KIND = "adoptions"
ADOPTED, FORCED, ROLLED_BACK = "adopted", "forced", "rolled back"
_DIGITS = 6


class MeanwhileError(InputError):
    """Somebody else has given the robot a model meanwhile."""


@dataclass(frozen=True, slots=True)
class Adoption:
    """A robot gets a model.

    Attributes:
        robot: Its slug.
        serial: Its serial number, None where it has none.
        action: "adopted", "forced" or "rolled back".
        model_id: Id of the model, None for the nominal one.
        diagnosis_id: Id of the diagnosis that found it.
        parent: Id of the adoption before it, None for the first.
        who: Name of the user.
        note: What he wrote about it.
        before, after: Held-out error of the model before and of this one [%].
        evidence: Everything that the gate saw.
    """

    robot: str
    serial: str | None
    action: str
    model_id: str | None
    diagnosis_id: str | None
    parent: str | None
    who: str
    note: str = ""
    before: float | None = None
    after: float | None = None
    evidence: Mapping | None = None


def commit_adoption(store: Path, made: Adoption) -> str:
    """Put an adoption into the store under the next number.

    Args:
        made: The adoption; its parent is what the robot had when it was judged.

    Raises:
        MeanwhileError: If the robot has got another model since.
        InputError: If an id or the robot's name is not usable.
    """
    check_slug(made.robot)
    lineage = {"model": [made.model_id], "diagnosis": [made.diagnosis_id]}
    parents = lineage_rows({k: ids for k, ids in lineage.items() if ids[0]})
    keep_made_with(store)
    while True:
        numbers = list_folders(store, KIND)
        _check_parent(store, made)
        id = f"{1 + max(map(int, numbers), default=0):0{_DIGITS}}"
        record = asdict(made)
        row = row_of(KIND, id, provenance(), record) | {"lineage": parents}
        told = {"record": record, "provenance": as_record(provenance())}
        texts = {k: json.dumps(v, ensure_ascii=False) for k, v in told.items()}
        table = one_row(KIND, row, texts)
        with staged(store, f"adoption-{id}") as folder:
            write_parquet(folder / KINDS[KIND].row, table)
            # Of two with one number one is told no, and looks again who was faster.
            if publish(folder, record_folder(store, KIND, id)):
                remember(store, KINDS[KIND], table)
                return id


def read_adoption(store: Path, id: str) -> Adoption:
    """Return an adoption.

    Raises:
        InputError: If there is none, or it is damaged.
    """
    path = record_folder(store, KIND, id) / KINDS[KIND].row
    record = json.loads(read_parquet(path, ["record"]).column("record")[0].as_py())
    return Adoption(**{f.name: record[f.name] for f in fields(Adoption)})


def adopted(
    store: Path, robot: str, serial: str | None = None
) -> tuple[str, Adoption] | None:
    """Return the last adoption of a robot with its number, None where there is none.

    Args:
        serial: Its serial number, None where it has none.

    Raises:
        InputError: If a record is damaged.
    """
    for id in sorted(list_folders(store, KIND), reverse=True):
        made = read_adoption(store, id)
        if (made.robot, made.serial) == (robot, serial):
            return id, made
    return None


def _check_parent(store: Path, made: Adoption) -> None:
    last = adopted(store, made.robot, made.serial)
    if (last[0] if last else None) == made.parent:
        return
    id, other = last
    raise MeanwhileError(
        f"{other.who} has given {made.robot} another model meanwhile (adoption "
        f"{int(id)}: {other.action} {other.model_id or 'the nominal model'}). Nothing "
        "was changed. Look at it with modelgap models, and try again if it still holds."
    )
