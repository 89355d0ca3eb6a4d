"""What a loop decided, and why: numbered records that are never changed.

The id of a record is made of its loop and its number, so a number can be taken only
once, as with adoptions: its folder is renamed into place. What is there is the whole
memory of a loop; it goes on from it after any kill.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

from residual.errors import InputError
from warehouse import ids
from warehouse.commit import one_row, row_of
from warehouse.files import publish, read_parquet, staged, write_parquet
from warehouse.kinds import KINDS
from warehouse.layout import record_folder
from warehouse.objects.mirror import is_there
from warehouse.origin.made_with import keep_made_with
from warehouse.origin.provenance import as_record, provenance
from warehouse.query.catalogue import remember
from warehouse.runs import lineage_rows

KIND = "decisions"


@dataclass(frozen=True, slots=True)
class Decision:
    """One step of a loop: what was done, why, and what came of it.

    Attributes:
        loop: Id of the loop.
        number: Its place in the loop, from 1.
        robot: Slug of the arm.
        serial: Its serial number, None where it has none.
        action: run, diagnose, adopt, drive or stop.
        reason: Why, in a sentence.
        outcome: What came of it, in a few words.
        made: Id of the record that it left in the store, None for none.
        seconds: Motion of the arm so far, this step included [s].
        result: What later steps go by, as JSON can hold it.
    """

    loop: str
    number: int
    robot: str
    serial: str | None
    action: str
    reason: str
    outcome: str
    made: str | None = None
    seconds: float = 0.0
    result: Mapping = field(default_factory=dict)


def commit_decision(store: Path, decision: Decision) -> str:
    """Put a decision into the store.

    Args:
        decision: The decision; its number is the next one of its loop.

    Raises:
        InputError: If that number is taken: the same loop runs elsewhere, too.
    """
    id = ids.decision_id(decision.loop, decision.number)
    record = ids.plain(asdict(decision))
    parents = {decision.action: [decision.made]} if decision.made else {}
    row = row_of(KIND, id, provenance(), record) | {"lineage": lineage_rows(parents)}
    told = {"record": record, "provenance": as_record(provenance())}
    texts = {k: json.dumps(v, ensure_ascii=False) for k, v in told.items()}
    table = one_row(KIND, row, texts)
    keep_made_with(store)
    with staged(store, f"decision-{id}") as folder:
        write_parquet(folder / KINDS[KIND].row, table)
        if not publish(folder, record_folder(store, KIND, id)):
            raise InputError(
                f"Decision {decision.number} of loop {decision.loop} is there already: "
                "the same loop runs in another process. Let that one go on."
            )
    remember(store, KINDS[KIND], table)
    return id


def read_decisions(store: Path, loop: str) -> tuple[Decision, ...]:
    """Return what a loop has decided so far, the first one first.

    Raises:
        InputError: If a record is damaged.
    """
    found: list[Decision] = []
    while True:
        id = ids.decision_id(loop, len(found) + 1)
        folder = record_folder(store, KIND, id)
        if not is_there(folder):
            return tuple(found)
        text = read_parquet(folder / KINDS[KIND].row, ["record"]).column("record")[0]
        record = json.loads(text.as_py())
        found.append(Decision(**{f.name: record[f.name] for f in fields(Decision)}))
