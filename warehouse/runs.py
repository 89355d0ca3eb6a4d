"""Read runs from the store, their seals and robots, and mark those not to be used."""

import json
from datetime import UTC, datetime
from pathlib import Path

from residual.errors import InputError
from residual.recording import Recording
from warehouse.record_commit import SPEC, TRUTH, SealedTruth, hash_sealed_spec
from warehouse.record_ids import (
    ID_DIGITS,
    build_seal_path,
    check_record_id,
    hash_arrays,
)
from warehouse.remote_store import (
    fetch_file,
    format_store_name,
    list_folder_names,
    record_exists,
)
from warehouse.store_catalogue import find_run
from warehouse.store_files import (
    read_parquet,
    read_row_text,
    replace_file,
    table_to_arrays,
    verify_file,
)
from warehouse.view_schema import KINDS, QUARANTINE, SAMPLES_FILE

_OF_RECORDING = ("t", "q", "tau", "qd", "qdd", "q_ref")


def read_manifest(store: Path, run_id: str) -> dict:
    """Return the manifest of a run (`commit.commit_run` says what is in it)."""
    return _manifest(find_run(store, run_id).folder)


def _manifest(folder: Path) -> dict:
    return json.loads(read_row_text(folder / KINDS["runs"].row, "manifest"))


def read_run(store: Path, run_id: str) -> Recording:
    """Return what was logged in a run, bit for bit as it was committed."""
    run = find_run(store, run_id)
    channels = read_verified_channels(run.folder)
    robot = run.folder.parent.name.removeprefix("robot=")
    logged = {name: channels[name] for name in _OF_RECORDING if name in channels}
    return Recording(id=run.id, robot=robot, **logged)


def read_channels(store: Path, run_id: str) -> dict:
    """Return all channels of a run by name, the errors of the twin among them."""
    return read_verified_channels(find_run(store, run_id).folder)


def read_verified_channels(folder: Path) -> dict:
    """Return the channels in a folder of a run, held against its record's hash."""
    path = folder / SAMPLES_FILE
    arrays = table_to_arrays(read_parquet(path))
    if hash_arrays(arrays) != _manifest(folder)["data_hash"]:
        raise InputError(
            f"{path} is damaged: its values are not those that were committed. "
            "Take its folder out of the store."
        )
    return arrays


def has_seal(store: Path, run_id: str) -> bool:
    """Return whether the hidden half of a run is in the store."""
    return record_exists(build_seal_path(store, run_id))


def open_seal(store: Path, run_id: str) -> SealedTruth:
    """Open the hidden half of a run: for reruns and for judging verdicts, only.

    Raises:
        InputError: If the run has no seal, or the seal is not the one that was hashed.
    """
    run = find_run(store, run_id)
    folder = build_seal_path(store, run.id)
    if not record_exists(folder):
        raise InputError(
            f"Run {run.id} has no sealed half in {format_store_name(store)}."
        )
    verify_file(folder / SPEC)
    try:
        spec = json.loads((folder / SPEC).read_bytes())
    except ValueError as error:
        raise InputError(f"{folder / SPEC} is damaged: it is no JSON.") from error
    manifest = _manifest(run.folder)
    truth = table_to_arrays(read_parquet(folder / TRUTH))
    hashed = manifest["sealed_sha256"], manifest["truth_hash"]
    if (hash_sealed_spec(spec), hash_arrays(truth)) != hashed:
        raise InputError(
            f"The seal of run {run.id} is broken: {folder} is not the seal that was "
            "hashed when the run was made."
        )
    return SealedTruth(spec, truth)


def quarantine_run(store: Path, run_id: str, reason: str) -> Path:
    """Mark a run as not to be used; the run itself stays unchanged.

    Returns:
        The tombstone; the first one stays.
    """
    if not reason.strip():
        raise InputError("A quarantine needs a reason, for those who find it later.")
    id = find_run(store, run_id).id
    target = _tombstone(store, id)
    fetch_file(target)
    if not target.exists():
        content = {"run_id": id, "reason": reason, "at": datetime.now(UTC).isoformat()}
        replace_file(store, target, (json.dumps(content) + "\n").encode())
    return target


def list_quarantined_runs(store: Path) -> frozenset[str]:
    """Return the ids of all runs with a tombstone."""
    names = list_folder_names(store, QUARANTINE)
    names = (n[:-5] for n in names if n.startswith("run_id=") and n.endswith(".json"))
    ids = (name.removeprefix("run_id=") for name in names)
    return frozenset(check_record_id(id) for id in ids if len(id) == ID_DIGITS)


def read_quarantine_reason(store: Path, run_id: str) -> str | None:
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
    return store / QUARANTINE / f"run_id={check_record_id(run_id)}.json"
