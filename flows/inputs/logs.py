"""The logs that a command is given: files, or ids of runs of the store."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from residual.errors import InputError
from residual.recording import Recording
from residual.robot.robot import Robot


@dataclass(frozen=True, slots=True)
class Logs:
    """All logs of one command, in the order of the words.

    Attributes:
        recordings: The logs; those of runs are called by the beginning of their id.
        lines: What was understood of them, for the user.
        warnings: What is odd but usable.
        runs: Whole ids of those that are runs, by the id of the recording.
    """

    recordings: tuple[Recording, ...]
    lines: tuple[str, ...]
    warnings: tuple[str, ...]
    runs: Mapping[str, str]


def read_words(
    words: Sequence[str], robot: Robot, columns: str | None, store: Path
) -> Logs:
    """Read every log once and make sure that no sample counts twice.

    Args:
        words: "FILE", "FILE@start:end", or the id of a run.
        robot: The arm that was logged.
        columns: COLUMNS.toml for the files, None for the default columns.
        store: Where the runs are.

    Raises:
        InputError: If a log is not usable or shares samples with another.
    """
    from warehouse.logs import check_distinct, load_columns, read_log, unique_ids

    known = load_columns(columns) if columns else None
    files = [word for word in words if not is_run(word)]
    labels = iter(unique_ids(files))
    logs: list[Recording] = []
    lines, warnings, runs = [], [], {}
    for word in words:
        if is_run(word):
            log, id, line = _read_run(word, robot, store)
            runs[log.id] = id
        else:
            log, told = read_log(word, robot, known, next(labels))
            line = told.text
            warnings += told.warnings
        logs.append(log)
        lines.append(line)
    check_distinct(logs)
    return Logs(tuple(logs), tuple(lines), tuple(warnings), runs)


def is_run(word: str) -> bool:
    """Whether a word can only be the id of a run: no such file, and only hex digits."""
    return not Path(word).exists() and not set(word) - set("0123456789abcdef")


def _read_run(word: str, robot: Robot, store: Path) -> tuple[Recording, str, str]:
    from warehouse.runs import read_run

    log = read_run(store, word)
    if log.dof != robot.dof:
        raise InputError(
            f"Run {log.id} has {log.dof} joints, {robot.name} has {robot.dof}. Give "
            "the run's own robot with --robot."
        )
    line = f"{log.id}: run of {log.robot}, {len(log.t)} samples, {log.duration:.2f} s"
    return replace(log, id=log.id[:8]), log.id, line
