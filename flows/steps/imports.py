"""Import measured logs into the store as runs."""

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from flows.inputs import LogSets, load_command_robot, require_logs, suggest_column_map
from flows.requests import LONGEST_WORD, Import, check_tags, is_short_word
from flows.settings import resolve_store_folder
from flows.steps.check import refuse_faulty_logs
from residual.check.result import LogCheck
from residual.errors import InputError, strip_control_characters
from residual.recording import Recording
from residual.robot.robot import Robot, set_serial_number
from warehouse.logs import ColumnMap, LogSummary, choose_column_map, create_unique_labels, read_log
from warehouse.logs.log_tables import format_timestamp, parse_timestamp
from warehouse.record_commit import commit_run, compute_imported_run_id
from warehouse.record_ids import build_record_path
from warehouse.record_ids import convert_to_json_types as plain_json
from warehouse.remote_store import record_exists
from warehouse.robots import store_robot_description
from warehouse.store_catalogue import read_manifest


@dataclass(frozen=True, eq=False, slots=True)
class ImportedLog:
    """One log as it would be stored."""

    recording: Recording  # the samples, in SI units at the link side
    summary: LogSummary  # of the file as read
    run_id: str  # the id that it has as a run
    stored: bool  # whether it is in the store already
    manifest: dict  # how it came to be


def read_logs(request: Import) -> tuple[Robot, tuple[ImportedLog, ...]]:
    """Read logs and determine their run ids; nothing is written."""
    require_logs(request.logs, "to import", "import")
    for what, word in (("trajectory", request.trajectory), ("kind", request.kind)):
        if word is not None and not is_short_word(word):
            raise InputError(
                f"--{what} '{word[:LONGEST_WORD]}': expected a short name such as 'welding'."
            )
    robot = set_serial_number(load_command_robot(request.robot, logs=request.logs), request.serial)
    if request.recorded_at is not None and len(request.logs) > 1:
        raise InputError(
            f"--recorded-at is the time of one log, {len(request.logs)} are given. "
            "Import them one by one."
        )
    columns, store = choose_column_map(robot, request.columns), resolve_store_folder(request.store)
    logs: dict[str, ImportedLog] = {}
    for spec, label in zip(request.logs, create_unique_labels(request.logs), strict=True):
        with suggest_column_map(spec, request.robot):
            recording, summary = read_log(spec, robot, columns, label, despite_doubts=True)
        run_id = compute_imported_run_id(recording, robot.content_hash)
        if run_id in logs:
            raise InputError(
                f"'{logs[run_id].summary.id}' and '{label}' hold the same samples: they are one "
                "run. Name it once."
            )
        recorded_at = summary.recorded_at
        if request.recorded_at is not None:
            recorded_at = parse_timestamp(request.recorded_at)
        logs[run_id] = ImportedLog(
            recording=recording,
            summary=summary,
            run_id=run_id,
            stored=record_exists(build_record_path(store, "runs", run_id, robot.name)),
            manifest={
                "source": "imported",
                "kind": request.kind,
                "trajectory": request.trajectory,
                "robot_hash": robot.content_hash,
                "serial": robot.serial,
                "recorded_at": format_timestamp(recorded_at),
                "tags": check_tags(request.tags),
                "log": _printable(plain_json(_about(summary, columns))),
            },
        )
    return robot, tuple(logs.values())


def check_logs(
    request: Import, robot: Robot, read: Sequence[ImportedLog]
) -> tuple[tuple[ImportedLog, ...], LogCheck]:
    """Check logs before they are stored; return them with the report in their records, and it."""
    columns = choose_column_map(robot, request.columns) or ColumnMap()
    sets = LogSets(
        robot,
        tuple(log.recording for log in read),
        columns=columns,
        doubts=tuple((log.summary.id, d) for log in read for d in log.summary.doubts),
    )
    _, report = refuse_faulty_logs(sets, request.trust_log)
    check_record = {"log_check": report.to_json()}
    with_check = (replace(log, manifest={**log.manifest, **check_record}) for log in read)
    return tuple(with_check), report


def store_log(log: ImportedLog, request: Import, robot: Robot) -> str:
    """Store a log; one that is already stored is unchanged."""
    store = resolve_store_folder(request.store)
    if log.stored:
        # Nothing is written, so the store may be read-only.
        read_manifest(store, log.run_id)
        with suppress(PermissionError):
            store_robot_description(store, request.robot, robot)
        return log.run_id
    store_robot_description(store, request.robot, robot)
    return commit_run(store, log.recording, log.manifest)


def _printable(value: object) -> object:
    """Return text of a foreign file without control characters for a terminal."""
    if isinstance(value, dict):
        return {key: _printable(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_printable(item) for item in value]
    return strip_control_characters(value) if isinstance(value, str) else value


def _about(summary: LogSummary, columns: ColumnMap | None) -> dict:
    """Facts about the file and how it was read; its name without its folder."""
    path = Path(summary.file)
    return {
        "file": path.name,
        "sha256": _sha256(path),
        "window": summary.window,
        "map": columns,
        "channels": [
            dict(zip(("channel", "column", "unit", "done"), channel, strict=True))
            for channel in summary.channels
        ],
        "ignored": summary.ignored,
        "notes": summary.notes,
        "warnings": summary.warnings,
    }


def _sha256(path: Path) -> str:
    """Hash of a file; of a folder, of the names and hashes of its files."""
    if path.is_file():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    total = hashlib.sha256()
    for part in sorted(part for part in path.rglob("*") if part.is_file()):
        total.update(f"{part.relative_to(path).as_posix()}\0{_sha256(part)}\n".encode())
    return total.hexdigest()
