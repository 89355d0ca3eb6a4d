"""Tombstones: why a run should not be used; nothing of it is deleted or changed."""

import json
from datetime import UTC, datetime
from pathlib import Path

from residual.errors import InputError
from warehouse.files import replace_file
from warehouse.ids import ID_DIGITS, check_id
from warehouse.layout import find_run
from warehouse.remote import fetch_file, names_in
from warehouse.schema import QUARANTINE


def quarantine(store: Path, run_id: str, reason: str) -> Path:
    """Say that a run should not be used; nothing of it is deleted or changed.

    Returns:
        The tombstone; the first one stays.
    """
    if not reason.strip():
        raise InputError("A quarantine needs a reason, for those who find it later.")
    id = find_run(store, run_id).id
    target = _tombstone(store, id)
    fetch_file(target)
    if not target.exists():
        told = {"run_id": id, "reason": reason, "at": datetime.now(UTC).isoformat()}
        replace_file(store, target, (json.dumps(told) + "\n").encode())
    return target


def quarantined(store: Path) -> frozenset[str]:
    """Return the ids of all runs with a tombstone."""
    names = names_in(store, QUARANTINE)
    names = (n[:-5] for n in names if n.startswith("run_id=") and n.endswith(".json"))
    ids = (name.removeprefix("run_id=") for name in names)
    return frozenset(check_id(id) for id in ids if len(id) == ID_DIGITS)


def tombstone(store: Path, run_id: str) -> str | None:
    """Return why a run should not be used, None where it may be."""
    path = _tombstone(store, run_id)
    fetch_file(path)
    try:
        return str(json.loads(path.read_bytes()).get("reason"))
    except FileNotFoundError:
        return None
    except (ValueError, AttributeError):
        return "its tombstone cannot be read"


def _tombstone(store: Path, run_id: str) -> Path:
    return store / QUARANTINE / f"run_id={check_id(run_id)}.json"
