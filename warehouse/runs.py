"""Read runs from the store, their seals and robots, and mark unusable ones."""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from residual.drive import Drive
from residual.errors import InputError
from residual.recording import Recording
from warehouse.record_commit import SPEC, TRUTH, SealedTruth, hash_sealed_spec
from warehouse.record_ids import ID_DIGITS, build_seal_path, check_record_id, hash_arrays
from warehouse.remote_store import fetch_file, format_store_name, list_folder_names, record_exists
from warehouse.store_catalogue import StoredRecord, find_run
from warehouse.store_files import (
    read_parquet,
    read_row_text,
    replace_file,
    table_to_arrays,
    verify_file,
)
from warehouse.view_schema import KINDS, LOGGED, QUARANTINE, SAMPLES_FILE


def read_manifest(store: Path, run_id: str) -> dict:
    """Return the manifest of a run (`commit.commit_run` says what is in it)."""
    return _manifest(find_run(store, run_id).folder)


def _manifest(folder: Path) -> dict:
    return json.loads(read_row_text(folder / KINDS["runs"].row, "manifest"))


def read_run(store: Path, run_id: str) -> Recording:
    """Return the log of a run, bit for bit as committed."""
    run = find_run(store, run_id)
    channels = read_verified_channels(run.folder)
    robot = run.folder.parent.name.removeprefix("robot=")
    logged = {name: channels[name] for name in LOGGED if name in channels}
    if (drive := _manifest(run.folder).get("drive")) is not None:
        lists = {k: tuple(v) if isinstance(v, list) else v for k, v in drive.items()}
        logged["drive"] = Drive(**lists)
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
            "Remove its folder from the store."
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
    spec, path = read_sealed_spec(store, run), build_seal_path(store, run.id) / TRUTH
    truth = table_to_arrays(read_parquet(path))
    if hash_arrays(truth) != _manifest(run.folder)["truth_hash"]:
        raise _broken(run, path)
    return SealedTruth(spec, truth)


def read_sealed_spec(store: Path, run: StoredRecord) -> dict:
    """Open the hidden spec of a run, without its hidden channels."""
    path = build_seal_path(store, run.id) / SPEC
    if not record_exists(path.parent):
        raise InputError(f"Run {run.id} has no sealed half in {format_store_name(store)}.")
    verify_file(path)
    try:
        spec = json.loads(path.read_bytes())
    except ValueError as error:
        raise InputError(f"{path} is damaged: it is not JSON.") from error
    if hash_sealed_spec(spec) != read_row_text(run.row, "sealed_sha256"):
        raise _broken(run, path)
    return spec


def _broken(run: StoredRecord, path: Path) -> InputError:
    return InputError(
        f"The seal of run {run.id} is broken: {path.parent} is not the seal that was "
        "hashed when the run was made."
    )


def quarantine_run(store: Path, run_id: str, reason: str) -> Path:
    """Mark a run as unusable; the run itself is unchanged.

    Returns:
        The tombstone; the first one is kept.
    """
    if not reason.strip():
        raise InputError("A quarantine needs a reason: it is shown with the run.")
    id = find_run(store, run_id).id
    return mark_run(store, QUARANTINE, id, {"reason": reason})


def mark_run(store: Path, mark: str, run_id: str, about: Mapping) -> Path:
    """Put a mark on a run, such as QUARANTINE; an existing one is kept."""
    target = _mark(store, mark, run_id)
    fetch_file(target)
    if not target.exists():
        content = {"run_id": run_id, **about, "at": datetime.now(UTC).isoformat()}
        replace_file(store, target, (json.dumps(content) + "\n").encode())
    return target


def list_marked_runs(store: Path, mark: str) -> frozenset[str]:
    """Return the ids of all runs with a mark, such as QUARANTINE."""
    names = list_folder_names(store, mark)
    names = (n[:-5] for n in names if n.startswith("run_id=") and n.endswith(".json"))
    ids = (name.removeprefix("run_id=") for name in names)
    return frozenset(check_record_id(id) for id in ids if len(id) == ID_DIGITS)


def read_quarantine_reason(store: Path, run_id: str) -> str | None:
    """Return why a run is in quarantine, None if it is not."""
    path = _mark(store, QUARANTINE, run_id)
    fetch_file(path)
    try:
        return str(json.loads(path.read_bytes()).get("reason"))
    except FileNotFoundError:
        return None
    except (ValueError, AttributeError):
        return "its tombstone cannot be read"


def _mark(store: Path, mark: str, run_id: str) -> Path:
    return store / mark / f"run_id={check_record_id(run_id)}.json"
