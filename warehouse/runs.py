"""Read runs from the store, their seals and robots, and mark those not to be used."""

import json
import re
import tomllib
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

import tomli_w

from residual.errors import InputError, ModelgapError
from residual.recording import Recording
from residual.robot.robot import (
    Robot,
    find_built_in_folder,
    list_built_in_robots,
    load_robot,
    parse_robot_reference,
)
from warehouse.record_commit import SPEC, TRUTH, SealedTruth, hash_sealed_spec
from warehouse.record_ids import (
    ID_DIGITS,
    build_seal_path,
    check_record_id,
    hash_arrays,
)
from warehouse.remote_store import (
    fetch_file,
    fetch_record,
    format_store_name,
    list_folder_names,
    record_exists,
)
from warehouse.store_catalogue import StoredRecord, find_run
from warehouse.store_files import (
    create_staging_folder,
    publish_folder,
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
    spec, path = read_sealed_spec(store, run), build_seal_path(store, run.id) / TRUTH
    truth = table_to_arrays(read_parquet(path))
    if hash_arrays(truth) != _manifest(run.folder)["truth_hash"]:
        raise _broken(run, path)
    return SealedTruth(spec, truth)


def read_sealed_spec(store: Path, run: StoredRecord) -> dict:
    """Open the hidden spec of a run, without what no robot logs."""
    path = build_seal_path(store, run.id) / SPEC
    if not record_exists(path.parent):
        raise InputError(
            f"Run {run.id} has no sealed half in {format_store_name(store)}."
        )
    verify_file(path)
    try:
        spec = json.loads(path.read_bytes())
    except ValueError as error:
        raise InputError(f"{path} is damaged: it is no JSON.") from error
    if hash_sealed_spec(spec) != read_row_text(run.row, "sealed_sha256"):
        raise _broken(run, path)
    return spec


def _broken(run: StoredRecord, path: Path) -> InputError:
    return InputError(
        f"The seal of run {run.id} is broken: {path.parent} is not the seal that was "
        "hashed when the run was made."
    )


# Descriptions of robots that do not come with the program, kept with their runs.
#
# ``robots/sha256=<hash>/<name>.urdf`` and, where there was one, ``robot.toml``; the
# hash is that of the robot (``Robot.content_hash``). So a run can be made again where
# the file that described its robot has changed or is not at hand.


ROBOTS, TOML = "robots", "robot.toml"


def store_robot_description(store: Path, reference: str, robot: Robot) -> None:
    """Put the description of a robot into the store, unless it is built in."""
    target = build_robot_path(store, robot.content_hash)
    built_in, place = (
        reference in list_built_in_robots(),
        Path(parse_robot_reference(reference)[0]),
    )
    if record_exists(target) or (
        built_in and load_robot(reference).content_hash == robot.content_hash
    ):
        return
    path = Path(str(find_built_in_folder(reference))) if built_in else place
    with create_staging_folder(store, "robot") as folder:
        try:
            # Its arm alone: a file of several, a xacro or an MJCF is read once.
            urdf = folder / f"{robot.name}.urdf"
            urdf.write_text(robot.urdf, encoding="utf-8")
            text = _toml_text(path, robot)
            if text is not None:
                (folder / TOML).write_text(text, encoding="utf-8")
            kept = load_robot(folder)
        except (OSError, ModelgapError):
            return
        # Edited since it was loaded: then there is nothing to keep.
        if (kept.content_hash, kept.name) == (robot.content_hash, robot.name):
            publish_folder(folder, target)


def _toml_text(path: Path, robot: Robot) -> str | None:
    """The robot.toml of a robot, which says its serial number too; None for none.

    A line is put into the user's own text, so that comments stay.
    """
    file = path / TOML if path.is_dir() else None
    text = file.read_text(encoding="utf-8") if file and file.is_file() else None
    used, written = json.loads(robot.toml), tomllib.loads(text or "")
    if set(used) - {"robot"} != set(written) - {"robot", "columns"}:
        # A chain has gone into the URDF; what an MJCF declares stands nowhere else.
        columns = {"columns": dict(robot.columns)} if robot.columns else {}
        return tomli_w.dumps(used | columns)
    if robot.serial is None or "serial" in tomllib.loads(text or "").get("robot", {}):
        return text
    line = f"serial = {json.dumps(robot.serial)}\n"
    table = re.search(r"^\[robot\][^\n]*\n", text or "", re.MULTILINE)
    if table:
        return text[: table.end()] + line + text[table.end() :]
    return f"[robot]\n{line}\n{text or ''}"


def find_robot_by_hash(store: Path, content_hash: str) -> str:
    """Return the word for the robot of a hash: a built-in name, or its kept folder."""
    for name in list_built_in_robots():
        if load_robot(name).content_hash == content_hash:
            return name
    folder = build_robot_path(store, content_hash)
    if fetch_record(folder):
        return str(folder)
    raise InputError(
        f"No description of the robot {content_hash[:8]} is in "
        f"{format_store_name(store)}. "
        "Import a log of it again with --robot, which keeps it."
    )


def find_used_robot(store: Path, reference: str, content_hash: str | None) -> str:
    """Return what to load a robot from, such that it is the one that was used.

    Args:
        content_hash: Its hash then; None where that is not known.
    """
    try:
        if content_hash in (None, load_robot(reference).content_hash):
            return reference
        why = f"{reference} describes another robot now"
    except ModelgapError as error:
        why = str(error)
    kept = build_robot_path(store, content_hash or "")
    if fetch_record(kept) and _hash(str(kept)) == content_hash:
        return str(kept)
    raise InputError(
        f"The robot that this was made with is not here: {why} And no description of "
        "it was kept in the store. Put back the URDF and robot.toml of that time."
    )


def build_robot_path(store: Path, content_hash: str) -> Path:
    """Return where a description is kept."""
    if len(content_hash) != 64 or set(content_hash) - set("0123456789abcdef"):
        raise InputError(f"'{content_hash}' is not the hash of a robot.")
    return store / ROBOTS / f"sha256={content_hash}"


@lru_cache(maxsize=8)
def _hash(folder: str) -> str | None:
    try:
        return load_robot(folder).content_hash
    except ModelgapError:
        return None


def quarantine_run(store: Path, run_id: str, reason: str) -> Path:
    """Mark a run as not to be used; the run itself stays unchanged.

    Returns:
        The tombstone; the first one stays.
    """
    if not reason.strip():
        raise InputError("A quarantine needs a reason, for those who find it later.")
    id = find_run(store, run_id).id
    return mark_run(store, QUARANTINE, id, {"reason": reason})


def mark_run(store: Path, mark: str, run_id: str, about: Mapping) -> Path:
    """Put a mark on a run, such as QUARANTINE; one that is there already stays."""
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
    """Return why a run should not be used, None where it may be."""
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
