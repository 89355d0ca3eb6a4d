"""Read the adoptions of a store; nothing of a model is loaded."""

from pathlib import Path
from typing import NamedTuple

from warehouse.record_commit import ADOPTIONS, ModelAdoption, read_adoption
from warehouse.record_ids import build_record_path
from warehouse.store_catalogue import list_record_folders
from warehouse.store_files import read_parquet
from warehouse.view_schema import KINDS


class AdoptionEntry(NamedTuple):
    """An adoption of a store, with its number and when it was made, in words."""

    number: str
    adoption: ModelAdoption
    since: str


def read_adoptions(store: Path) -> list[AdoptionEntry]:
    """Return all adoptions, the first one first."""
    out = []
    for id in list_record_folders(store, ADOPTIONS):
        path = build_record_path(store, ADOPTIONS, id) / KINDS[ADOPTIONS].row
        created = read_parquet(path, ["created"]).column("created")[0].as_py()
        since = f"{created:%Y-%m-%d %H:%M}"
        out.append(AdoptionEntry(id, read_adoption(store, id), since))
    return out


def describe_diagnosis_adoption(store: Path, diagnosis: str) -> str:
    """Return whether the model of a diagnosis is adopted, in one line."""
    entries = read_adoptions(store)
    last = {(record.robot, record.serial): id for id, record, _ in entries}
    for id, record, since in reversed(entries):
        if record.diagnosis_id == diagnosis:
            current = last[record.robot, record.serial] == id
            now = "the current model" if current else "replaced since"
            return f"adopted: adoption {int(id)} of {record.robot}, {since}; {now}"
    return f"not adopted: modelgap adopt {diagnosis[:8]}"
