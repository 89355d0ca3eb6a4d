"""Read the logs (files, or ids of runs of the store) and the robot of a command."""

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from flows.requests import Request
from flows.settings import resolve_store_folder
from residual.effects import list_effect_parameters, load_effects, map_joint_properties
from residual.errors import InputError, check_name, shorten_value
from residual.model.nominal import list_known_values, refuse_known_values_with_baseline
from residual.recording import Recording, apply_drive
from residual.robot.robot import (
    Robot,
    add_known_values,
    format_robot_reference,
    load_robot,
    set_serial_number,
)
from warehouse.logs import (
    ColumnMap,
    LogDoubt,
    MissingColumnsError,
    check_logs_distinct,
    choose_column_map,
    create_unique_labels,
    read_log,
)
from warehouse.logs.log_window import split_log_spec
from warehouse.logs.ros_bags import list_joint_topics
from warehouse.robots import find_robot_by_hash
from warehouse.store_catalogue import read_manifest, read_run

R = TypeVar("R", bound=Request)


@dataclass(frozen=True, eq=False, slots=True)
class LogSets:
    """All logs of one command, by their purpose."""

    robot: Robot
    # Logs to fit; those of runs are called by the beginning of their id.
    fit: tuple[Recording, ...]
    baseline: tuple[Recording, ...] = ()  # logs of healthy runs
    held_out: tuple[Recording, ...] = ()  # logs for the proof
    # How each was read, in the order of the three sets.
    each: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()  # odd but usable input
    # Complete ids of those that are runs, by the id of the recording.
    runs: Mapping[str, str] | None = None
    columns: ColumnMap = field(default_factory=ColumnMap)  # how the files were read
    # Why logs can be none of this arm, with the label of the log; only where they were
    # read for a check.
    doubts: tuple[tuple[str, LogDoubt], ...] = ()

    @property
    def lines(self) -> tuple[str, ...]:
        """How the logs were read, for the user; the first line has their roles.

        Logs that were read alike are one line.
        """
        notes = [f"{self.robot.name}: {note}" for note in self.robot.notes]
        if not self.each:
            return tuple(notes)
        sets = {"fit": self.fit, "baseline": self.baseline, "held out": self.held_out}
        use = " | ".join(
            f"{name}: {' '.join(log.id for log in logs) or '–'}" for name, logs in sets.items()
        )
        return (use, *notes, *merge_equal_lines(self.each))


_NAMED = 8  # logs of a line; a campaign has thousands


def merge_equal_lines(lines: Sequence[str]) -> tuple[str, ...]:
    """Return one line for all logs read alike.

    Args:
        lines: Of each log: "id: size, size; what was read; what was done; ...".
    """
    groups: dict[str, list[tuple[str, str]]] = {}
    for line in lines:
        about, _, remaining = line.partition("; ")
        name, _, size = about.partition(": ")
        groups.setdefault(remaining, []).append((name, size))
    out = []
    for remaining, logs in groups.items():
        same = len({size for _, size in logs}) == 1
        names = [name if same else f"{name} ({size})" for name, size in logs]
        text = ", ".join(names[:_NAMED])
        text += f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        text += f": {logs[0][1]}" if same else ""
        out.append(f"{text}; {remaining}" if remaining else text)
    return tuple(out)


def read_log_sets(
    sets: tuple[Sequence[str], Sequence[str], Sequence[str]],
    robot: Robot,
    columns: str | None,
    store: str | Path | None,
    to_check: bool = False,
    called: str = "R",
) -> LogSets:
    """Read every log once and make sure that no sample counts twice.

    Args:
        sets: Logs to fit, of the baseline, and held out: "FILE", "FILE@start:end", or
            the id of a run.
        to_check: Whether a check follows, which explains samples that cannot be of this
            arm; without it they are an error.
        called: Name of the robot as the user gave it, for a suggested command.
    """
    place = resolve_store_folder(store)
    column_map = choose_column_map(robot, columns) or ColumnMap()
    words = [word for part in sets for word in part]
    labels = iter(create_unique_labels([word for word in words if not is_run_id(word)]))
    logs: list[Recording] = []
    lines, warnings, runs, doubts = [], [], {}, []
    for word in words:
        if is_run_id(word):
            run = read_run(place, word)
            if run.dof != robot.dof:
                raise InputError(
                    f"Run {run.id} has {run.dof} joints, {robot.name} has {robot.dof}. "
                    "Give the run's own robot with --robot."
                )
            log = replace(run, id=run.id[:8])
            size = f"{len(log.t)} samples, {log.duration:.2f} s"
            line = f"{run.id}: run of {log.robot}, {size}"
            if run.drive is None or column_map.drive is None:
                runs[log.id] = run.id
            else:  # a pasted line of the check, which the stored run lacks
                log = apply_drive(log, column_map.drive)
                line += "; torque computed from the map's drive, so its verdict is not stored"
        else:
            with suggest_column_map(word, called):
                log, understood = read_log(word, robot, column_map, next(labels), to_check)
            line = understood.text
            warnings += understood.warnings
            doubts += [(log.id, doubt) for doubt in understood.doubts]
        logs.append(log)
        lines.append(line)
    check_logs_distinct(logs)
    remaining = iter(logs)
    parts = [tuple(next(remaining) for _ in part) for part in sets]
    about = (tuple(lines), tuple(warnings), runs, column_map, tuple(doubts))
    return LogSets(robot, *parts, *about)


@contextmanager
def suggest_column_map(log: str, robot: str) -> Iterator[None]:
    """Add to the error of unknown columns how to draft a map."""
    try:
        yield
    except MissingColumnsError as error:
        words = ["modelgap", "map", log, "--robot", robot, "--out", "COLUMNS.toml"]
        raise MissingColumnsError(f"{error} A draft of it: {shlex.join(words)}") from error


def read_logs(request: Request, purpose: str, robot: Robot | None = None) -> LogSets:
    """Read the robot and every log of a request once, also impossible ones.

    Args:
        purpose: Their use, such as "to diagnose".
        robot: Their robot, without --known; None for the one that the request names.
    """
    held_out = getattr(request, "held_out", ())
    baseline = getattr(request, "baseline", ())
    robot = robot or load_request_robot(request)
    if hasattr(request, "known"):
        robot = apply_known_values(robot, parse_known_values(request.known), baseline)
    for name in getattr(request, "declared", None) or ():
        check_name(name, load_effects(), "effect in --declared")
    require_logs(request.logs, purpose, request.command)
    sets = (request.logs, baseline, held_out)
    columns, store = request.columns, request.store
    return read_log_sets(sets, robot, columns, store, True, called=request.robot)


def require_logs(words: Sequence[str], purpose: str, command: str) -> None:
    """Refuse a command without any log."""
    if not words:
        raise InputError(f"No log {purpose}. Give it first: modelgap {command} LOG ... --robot R.")


def select_request_runs(
    request: R, words: Sequence[str], where: str | None = None, held_out_where: str | None = None
) -> R:
    """Return a request with its logs: words of the line, and runs chosen by query.

    Raises:
        InputError: If one is no condition, or no run fulfils it.
    """
    sets = {"logs": (*words, *query_run_ids(request.store, where))}
    if held_out_where is not None:
        proof = query_run_ids(request.store, held_out_where)
        sets["held_out"] = (*request.held_out, *proof)
    return replace(request, **sets)


def query_run_ids(store: str | Path | None, where: str | None) -> tuple[str, ...]:
    """Return the ids of the runs that fulfil a condition; none where there is none."""
    if where is None:
        return ()
    # DuckDB, which no command without a condition needs.
    from warehouse.queries import select_run_ids

    return select_run_ids(resolve_store_folder(store), where)


def is_run_id(word: str) -> bool:
    """Whether a word can only be the id of a run: no such file, and only hex digits."""
    return not Path(word).exists() and not set(word) - set("0123456789abcdef")


# Robots by name or file; a rerun may say that another file stands for one of them.
_INSTEAD: ContextVar[Mapping[str, str]] = ContextVar("instead", default={})  # noqa: B039


def load_command_robot(
    word: str | Path,
    *,
    chain: Sequence[str] = (),
    tip: str | None = None,
    xacro_args: Sequence[str] = (),
    package_dirs: Sequence[str] = (),
    logs: Sequence[str] = (),
) -> Robot:
    """Load a robot: built-in name, robot file (URDF, xacro, MJCF) or folder.

    Args:
        chain: Names of the joints of the arm, where the file has more.
        tip: The link that the arm ends with, in place of their names.
        xacro_args: Arguments of a xacro, "name:=value".
        package_dirs: Folders where its packages are.
        logs: Bags, whose names of joints choose a chain where nothing else does.

    Raises:
        InputError: If the robot is not usable, or the logs are of several chains.
    """
    word = format_robot_reference(word, chain, tip, xacro_args, package_dirs)
    named = dict.fromkeys(names for log in logs if (names := _logged(log)))
    return _of_names(word, [*named])


def _of_names(word: str, named: Sequence[Sequence[str]]) -> Robot:
    effects, properties = list_effect_parameters(), map_joint_properties()
    word = _INSTEAD.get().get(word, word)
    robots = [load_robot(word, effects, properties, names) for names in (named or [()])]
    chains = {robot.joints for robot in robots}
    if len(chains) > 1:
        two = " and ".join(", ".join(chain) for chain in sorted(chains)[:2])
        raise InputError(
            f"The logs are of several chains of {robots[0].name}: {two}. Give logs of "
            "one, or choose it with --chain or --tip."
        )
    return robots[0]


def _logged(log: str) -> tuple[str, ...]:
    """Joint names of a log, of all topics of a bag; () for none."""
    try:
        path, _ = split_log_spec(log)
        names = list_joint_topics(path).values()
    except InputError:  # its reader reports it, with the expected form
        return ()
    return tuple(dict.fromkeys(n for some in names for n in some))


@contextmanager
def substitute_robot_files(words: Mapping[str, str]) -> Iterator[None]:
    """Load other files in place of robot words, within a block."""
    token = _INSTEAD.set(words)
    try:
        yield
    finally:
        _INSTEAD.reset(token)


def read_run_robot(runs: Sequence[str], store: Path) -> str:
    """Return the name or file of the robot of some runs."""
    if not runs:
        raise InputError("No run given, expected one or more ids.")
    manifest = read_manifest(store, runs[0])
    if "spec" not in manifest:
        return find_robot_by_hash(store, manifest["robot_hash"])
    return manifest.get("robot") or manifest["spec"]["robot"]["name"]


def load_request_robot(request: Request) -> Robot:
    """Load the robot of a request with logs, as `load_command_robot` does."""
    logs = (*request.logs, *getattr(request, "held_out", ()))
    return load_run_robot(request.robot, logs, request.store)


def load_run_robot(word: str, runs: Sequence[str], store: str | Path | None) -> Robot:
    """Load the robot of some runs, with the serial number that they were stored with.

    Args:
        word: Built-in name, URDF file or folder; it may say no serial number.
        runs: Logs of one arm; only those that are ids of runs are asked.

    Raises:
        InputError: If the runs are of arms with different serial numbers, or of another
            one than robot.toml says; or there is no such run.
    """
    place = resolve_store_folder(store)
    manifests = {run: read_manifest(place, run) for run in runs if is_run_id(run)}
    named = [names for run in runs if not is_run_id(run) and (names := _logged(run))]
    hashes = {m.get("robot_hash") for m in manifests.values()} - {None}
    robot = None
    if not named:
        # Where it may be of several chains, the robots of the runs say which.
        with suppress(*([InputError] if hashes else [])):
            robot = _of_names(word, ())
    if robot is None or hashes - {robot.content_hash}:
        for hash in hashes:
            with suppress(InputError):  # without a stored description the word decides
                named.append(load_command_robot(find_robot_by_hash(place, hash)).joints)
        robot = _of_names(word, list(dict.fromkeys(named)))
    plants = {id for id, m in manifests.items() if "spec" in m and m.get("serial")}
    if plants:  # robot.toml describes them all, so its own serial number applies to none
        robot = replace(robot, serial=None)
    for run, manifest in manifests.items():
        serial = manifest.get("serial")
        if serial is not None and robot.serial not in (None, serial):
            raise InputError(
                f"Run {run} is of {robot.name} {serial}, expected one of {robot.name} "
                f"{robot.serial} like the rest. Give runs of one arm."
            )
        # That of a plant is no part of its description, whose hash its runs have.
        robot = replace(robot, serial=serial) if run in plants else set_serial_number(robot, serial)
    return robot


def read_file_serial(robot: Robot) -> str | None:
    """Return the serial number of robot.toml; a plant has none in it."""
    return json.loads(robot.toml).get("robot", {}).get("serial")


def read_run_serial(run: str, store: str | Path | None) -> str | None:
    """Return the serial number of the arm of a run, None where it has none."""
    return read_manifest(resolve_store_folder(store), run).get("serial")


def apply_known_values(robot: Robot, known: Mapping[str, float], baseline: Sequence = ()) -> Robot:
    """Return the robot with values that are known for sure, checked.

    Raises:
        InputError: If one cannot be known, or there is a baseline.
    """
    robot = add_known_values(robot, known)
    list_known_values(robot)
    if baseline:
        refuse_known_values_with_baseline(robot)
    return robot


def parse_known_values(words: Sequence[str]) -> dict[str, float]:
    """Return the values of --known, such as "payload.mass=2.8", by name."""
    out = {}
    for word in words:
        name, equals, text = word.partition("=")
        try:
            out[name.strip()] = float(text)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(
                f"--known '{shorten_value(word)}': expected NAME.PARAMETER=NUMBER, such as "
                "payload.mass=2.8 or coulomb.2.level=8."
            )
    return out
