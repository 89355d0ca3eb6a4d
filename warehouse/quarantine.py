"""Tombstones: a run that should not be used stays, and says so."""

import json
from datetime import UTC, datetime
from pathlib import Path

from residual.errors import InputError
from warehouse.files import replace_file
from warehouse.ids import ID_DIGITS, check_id
from warehouse.layout import QUARANTINE, find_run


def quarantine(store: Path, run_id: str, reason: str) -> Path:
    """Say that a run should not be used; nothing of it is deleted or changed.

    Args:
        store: The store.
        run_id: Id of the run, or its beginning.
        reason: Why, for people.

    Returns:
        The tombstone; the first one stays.

    Raises:
        InputError: If there is no such run, or no reason.
    """
    if not reason.strip():
        raise InputError("A quarantine needs a reason, for those who find it later.")
    id = find_run(store, run_id).id
    target = store / QUARANTINE / f"run_id={id}.json"
    if not target.exists():
        told = {"run_id": id, "reason": reason, "at": datetime.now(UTC).isoformat()}
        replace_file(store, target, (json.dumps(told) + "\n").encode())
    return target


def quarantined(store: Path) -> frozenset[str]:
    """Return the ids of all runs with a tombstone."""
    names = (path.stem for path in (store / QUARANTINE).glob("run_id=*.json"))
    ids = (name.removeprefix("run_id=") for name in names)
    return frozenset(check_id(id) for id in ids if len(id) == ID_DIGITS)


def tombstone(store: Path, run_id: str) -> str | None:
    """Return why a run should not be used, None where it may be."""
    path = store / QUARANTINE / f"run_id={check_id(run_id)}.json"
    try:
        return str(json.loads(path.read_bytes()).get("reason"))
    except FileNotFoundError:
        return None
    except (ValueError, AttributeError):
        return "its tombstone cannot be read"
