"""Runs back out of the store: their samples, their manifest, seals and tombstones."""

import json
from datetime import UTC, datetime
from pathlib import Path

from residual.errors import InputError
from residual.recording import Recording
from warehouse.commit import SPEC, TRUTH, Sealed, sealed_hash
from warehouse.files import (
    check_file,
    read_cell,
    read_parquet,
    replace_file,
    to_arrays,
)
from warehouse.ids import ID_DIGITS, check_id, data_hash, seal_folder
from warehouse.layout import find_run
from warehouse.mirror import ensure_local, is_there, names_in, shown
from warehouse.schema import KINDS, QUARANTINE, SAMPLES_FILE

_OF_RECORDING = ("t", "q", "tau", "qd", "qdd", "q_ref")


def read_manifest(store: Path, run_id: str) -> dict:
    """Return the manifest of a run (`commit.commit_run` says what is in it)."""
    return _manifest(find_run(store, run_id).folder)


def _manifest(folder: Path) -> dict:
    return json.loads(read_cell(folder / KINDS["runs"].row, "manifest"))


def read_run(store: Path, run_id: str) -> Recording:
    """Return what was logged in a run, bit for bit as it was committed."""
    run = find_run(store, run_id)
    channels = check_samples(run.folder)
    robot = run.folder.parent.name.removeprefix("robot=")
    logged = {name: channels[name] for name in _OF_RECORDING if name in channels}
    return Recording(id=run.id, robot=robot, **logged)


def read_channels(store: Path, run_id: str) -> dict:
    """Return all channels of a run by name, the errors of the twin among them."""
    return check_samples(find_run(store, run_id).folder)


def check_samples(folder: Path) -> dict:
    """Return the channels in a folder of a run, held against its record's hash."""
    path = folder / SAMPLES_FILE
    arrays = to_arrays(read_parquet(path))
    if data_hash(arrays) != _manifest(folder)["data_hash"]:
        raise InputError(
            f"{path} is damaged: its values are not those that were committed. "
            "Take its folder out of the store."
        )
    return arrays


def has_seal(store: Path, run_id: str) -> bool:
    """Return whether the hidden half of a run is in the store."""
    return is_there(seal_folder(store, run_id))


def open_seal(store: Path, run_id: str) -> Sealed:
    """Open the hidden half of a run: for reruns and for judging verdicts, only.

    Raises:
        InputError: If the run has no seal, or the seal is not the one that was hashed.
    """
    run = find_run(store, run_id)
    folder = seal_folder(store, run.id)
    check_file(folder / SPEC)
    try:
        spec = json.loads((folder / SPEC).read_bytes())
    except FileNotFoundError as error:
        raise InputError(
            f"Run {run.id} has no sealed half in {shown(store)}."
        ) from error
    except ValueError as error:
        raise InputError(f"{folder / SPEC} is damaged: it is no JSON.") from error
    manifest = _manifest(run.folder)
    truth = to_arrays(read_parquet(folder / TRUTH))
    hashed = manifest["sealed_sha256"], manifest["truth_hash"]
    if (sealed_hash(spec), data_hash(truth)) != hashed:
        raise InputError(
            f"The seal of run {run.id} is broken: {folder} is not the seal that was "
            "hashed when the run was made."
        )
    return Sealed(spec, truth)


def quarantine(store: Path, run_id: str, reason: str) -> Path:
    """Say that a run should not be used; nothing of it is deleted or changed.

    Returns:
        The tombstone; the first one stays.

    Raises:
        InputError: If there is no such run, or no reason.
    """
    if not reason.strip():
        raise InputError("A quarantine needs a reason, for those who find it later.")
    id = find_run(store, run_id).id
    target = _tombstone(store, id)
    ensure_local(target)
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
    ensure_local(path)
    try:
        return str(json.loads(path.read_bytes()).get("reason"))
    except FileNotFoundError:
        return None
    except (ValueError, AttributeError):
        return "its tombstone cannot be read"


def _tombstone(store: Path, run_id: str) -> Path:
    return store / QUARANTINE / f"run_id={check_id(run_id)}.json"
