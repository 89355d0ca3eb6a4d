"""What a command is given: logs, as files or ids of runs of the store, and robots."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from flows.requests import Request
from flows.settings import store_folder
from residual.effects import joint_properties, registry, vocabulary
from residual.errors import InputError, check_name, shortened
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot, with_serial
from residual.robot.word import word_of
from warehouse.logs import (
    ColumnMap,
    Doubt,
    MissingColumnsError,
    check_distinct,
    columns_of,
    read_any,
    read_log,
    unique_ids,
)
from warehouse.logs.ros import topics
from warehouse.logs.window import split_spec
from warehouse.runs import read_manifest, read_run, robot_of_hash

R = TypeVar("R", bound=Request)


@dataclass(frozen=True, eq=False, slots=True)
class LogSets:
    """All logs of one command, by what they are for."""

    robot: Robot
    # Logs to fit; those of runs are called by the beginning of their id.
    fit: tuple[Recording, ...]
    baseline: tuple[Recording, ...] = ()  # logs of healthy runs
    held_out: tuple[Recording, ...] = ()  # logs for the proof
    # What was understood of each, in the order of the three sets.
    each: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()  # what is odd but usable
    # Whole ids of those that are runs, by the id of the recording.
    runs: Mapping[str, str] | None = None
    columns: ColumnMap = field(default_factory=ColumnMap)  # how the files were read
    # Why logs can be none of this arm, with the label of the log; only where they were
    # read for a check.
    doubts: tuple[tuple[str, Doubt], ...] = ()

    @property
    def lines(self) -> tuple[str, ...]:
        """What was understood, for the user; the first says which log is used as what.

        Logs that were read alike are one line.
        """
        use = [_use(self.fit, self.baseline, self.held_out)] if self.each else []
        notes = [f"{self.robot.name}: {note}" for note in self.robot.notes]
        return (*use, *notes, *in_short(self.each))


_NAMED = 8  # logs of a line; a campaign has thousands


def in_short(lines: Sequence[str]) -> tuple[str, ...]:
    """Return one line for logs that were read alike, of others what differs.

    Args:
        lines: Of each log: "id: size, size; what was read; what was done; ...".
    """
    groups: dict[tuple[str, ...], list[str]] = {}
    for line in lines:
        about, *parts = line.split("; ")
        groups.setdefault(tuple(parts), []).append(about)
    first, out = next(iter(groups), ()), []
    for parts, abouts in groups.items():
        new = [part for part in parts if part not in first]
        # What is neither the same nor said in its place, such as another unit of q.
        kinds = {part.partition(" ")[0] for part in new}
        gone = [p for p in first if p not in parts and p.partition(" ")[0] not in kinds]
        if out and len(new) + len(gone) < len(parts):
            name = groups[first][0].partition(": ")[0]
            new = [f"else as {name}", *new, *(f"without: {part}" for part in gone)]
        else:
            new = list(parts)
        out.append("; ".join([_sizes(abouts), *new]))
    return tuple(out)


def _sizes(abouts: Sequence[str]) -> str:
    """Return names and sizes of logs; what all have in common once."""
    named = [about.partition(": ") for about in abouts]
    sizes = [size.split(", ") for _, _, size in named]
    same = [set(column) for column in zip(*sizes, strict=False)]
    common = [next(iter(each)) for each in same if len(each) == 1]
    if len({len(size) for size in sizes}) > 1:
        common = []
    listed = []
    for (name, _, _), size in zip(named[:_NAMED], sizes, strict=False):
        own = ", ".join(part for part in size if part not in common)
        listed.append(f"{name} ({own})" if own and len(named) > 1 else name)
    more = len(named) - len(listed)
    names = ", ".join(listed) + (f" and {more} more" if more else "")
    shown = ", ".join(common)
    return f"{names}: {shown}" if shown else names


def read_sets(
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
        to_check: Whether a check follows, which tells why samples can be none of this
            arm; without it they are an error.
        called: What the user calls the robot, for a line that is offered.
    """
    place = store_folder(store)
    known = columns_of(robot, columns) or ColumnMap()
    read = read_any if to_check else read_log
    words = [word for part in sets for word in part]
    labels = iter(unique_ids([word for word in words if not is_run(word)]))
    logs: list[Recording] = []
    lines, warnings, runs, doubts = [], [], {}, []
    for word in words:
        if is_run(word):
            log, id, line = _read_run(word, robot, place)
            runs[log.id] = id
        else:
            with offer_map(word, called):
                log, told = read(word, robot, known, next(labels))
            line = told.text
            warnings += told.warnings
            doubts += [(log.id, doubt) for doubt in told.doubts]
        logs.append(log)
        lines.append(line)
    check_distinct(logs)
    rest = iter(logs)
    parts = [tuple(next(rest) for _ in part) for part in sets]
    told = (tuple(lines), tuple(warnings), runs)
    return LogSets(robot, *parts, *told, known, tuple(doubts))


@contextmanager
def offer_map(log: str, robot: str) -> Iterator[None]:
    """Say of a log with other columns how a map of them is drafted."""
    try:
        yield
    except MissingColumnsError as error:
        words = ["modelgap", "map", log, "--robot", robot, "--out", "COLUMNS.toml"]
        raise MissingColumnsError(
            f"{error} A draft of it: {shlex.join(words)}"
        ) from error


def read_logs(request: Request, purpose: str, robot: Robot | None = None) -> LogSets:
    """Read the robot and every log of a request once.

    Args:
        purpose: What they are needed for, such as "to diagnose".
        robot: Their robot; None for the one that the request names.
    """
    held_out = getattr(request, "held_out", ())
    words = (*request.logs, *held_out)
    robot = robot or load_of(request.robot, words, request.store)
    check_declared(getattr(request, "declared", None))
    need_logs(request.logs, purpose, request.command)
    sets = (request.logs, getattr(request, "baseline", ()), held_out)
    columns, store = request.columns, request.store
    return read_sets(sets, robot, columns, store, True, called=request.robot)


def need_logs(words: Sequence[str], purpose: str, command: str) -> None:
    """Refuse a command without any log."""
    if not words:
        raise InputError(
            f"No log {purpose}. Name it first: modelgap {command} LOG ... --robot R."
        )


def chosen(
    request: R,
    words: Sequence[str],
    where: str | None = None,
    held_out_where: str | None = None,
) -> R:
    """Return a request with its logs: words of the line, and runs chosen by query.

    Args:
        where: A condition over the view runs; the ids of what fulfils it follow.
        held_out_where: The same for what is held out.

    Raises:
        InputError: If one is no condition, or no run fulfils it.
    """
    sets = {"logs": (*words, *queried(request.store, where))}
    if held_out_where is not None:
        proof = queried(request.store, held_out_where)
        sets["held_out"] = (*request.held_out, *proof)
    return replace(request, **sets)


def queried(store: str | Path | None, where: str | None) -> tuple[str, ...]:
    """Return the ids of the runs that fulfil a condition; none where there is none."""
    if where is None:
        return ()
    # DuckDB, which no command without a condition needs.
    from warehouse.query.store import runs_where

    return runs_where(store_folder(store), where)


def is_run(word: str) -> bool:
    """Whether a word can only be the id of a run: no such file, and only hex digits."""
    return not Path(word).exists() and not set(word) - set("0123456789abcdef")


def _use(*sets: tuple[Recording, ...]) -> str:
    """Return one line that says which log is used as what."""
    names = ("fit", "baseline", "held out")
    parts = (" ".join(log.id for log in logs) or "–" for logs in sets)
    return " | ".join(f"{n}: {p}" for n, p in zip(names, parts, strict=True))


def _read_run(word: str, robot: Robot, store: Path) -> tuple[Recording, str, str]:
    log = read_run(store, word)
    if log.dof != robot.dof:
        raise InputError(
            f"Run {log.id} has {log.dof} joints, {robot.name} has {robot.dof}. Give "
            "the run's own robot with --robot."
        )
    line = f"{log.id}: run of {log.robot}, {len(log.t)} samples, {log.duration:.2f} s"
    return replace(log, id=log.id[:8]), log.id, line


# Robots by name or file; a rerun may say that another file stands for one of them.
_INSTEAD: ContextVar[Mapping[str, str]] = ContextVar("instead", default={})  # noqa: B039


def load(
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
    word = word_of(word, chain, tip, xacro_args, package_dirs)
    named = dict.fromkeys(names for log in logs if (names := _logged(log)))
    return _of_names(word, [*named])


def _of_names(word: str, named: Sequence[Sequence[str]]) -> Robot:
    """Load a robot whose chain the names of joints, log by log, may say."""
    known, own = vocabulary(), joint_properties()
    word = _INSTEAD.get().get(word, word)
    robots = [load_robot(word, known, own, names) for names in (named or [()])]
    chains = {robot.joints for robot in robots}
    if len(chains) > 1:
        told = " and ".join(", ".join(chain) for chain in sorted(chains)[:2])
        raise InputError(
            f"The logs are of several chains of {robots[0].name}: {told}. Give logs of "
            "one, or choose it with --chain or --tip."
        )
    return robots[0]


def _logged(log: str) -> tuple[str, ...]:
    """Names of the joints that a log has, of all topics of a bag; () for none."""
    try:
        path, _ = split_spec(log)
        names = topics(path).values()
    except InputError:  # it is said by who reads it, with what it should be
        return ()
    return tuple(dict.fromkeys(n for some in names for n in some))


@contextmanager
def instead(words: Mapping[str, str]) -> Iterator[None]:
    """Load other files than the words say, for the time being."""
    token = _INSTEAD.set(words)
    try:
        yield
    finally:
        _INSTEAD.reset(token)


def robot_of(runs: Sequence[str], store: Path) -> str:
    """Return the name or file of the robot of some runs."""
    if not runs:
        raise InputError("No run given, expected one or more ids.")
    manifest = read_manifest(store, runs[0])
    if "spec" not in manifest:
        return robot_of_hash(store, manifest["robot_hash"])
    return manifest.get("robot") or manifest["spec"]["robot"]["name"]


def load_of(word: str, runs: Sequence[str], store: str | Path | None) -> Robot:
    """Load the robot of some runs, with the serial number that they were stored with.

    Args:
        word: Built-in name, URDF file or folder; it may say no serial number.
        runs: Logs of one arm; only those that are ids of runs are asked.

    Raises:
        InputError: If the runs are of arms with different serial numbers, or of another
            one than robot.toml says; or there is no such run.
    """
    ids, files = [r for r in runs if is_run(r)], [r for r in runs if not is_run(r)]
    named = [*filter(None, map(_logged, files)), *_chains_of(ids, store)]
    robot = _of_names(word, list(dict.fromkeys(named)))
    for run in ids:
        serial = serial_of(run, store)
        if serial is not None and robot.serial not in (None, serial):
            raise InputError(
                f"Run {run} is of {robot.name} {serial}, expected one of {robot.name} "
                f"{robot.serial} like the rest. Give runs of one arm."
            )
        robot = with_serial(robot, serial)
    return robot


def _chains_of(ids: Sequence[str], store: str | Path | None) -> list[tuple[str, ...]]:
    """Names of the joints of the robots that runs were stored with."""
    place, out = store_folder(store), []
    for hash in {read_manifest(place, run).get("robot_hash") for run in ids} - {None}:
        with suppress(InputError):  # of one that was not kept the word says all
            out.append(load(robot_of_hash(place, hash)).joints)
    return out


def serial_of(run: str, store: str | Path | None) -> str | None:
    """Return the serial number of the arm of a run, None where it has none."""
    return read_manifest(store_folder(store), run).get("serial")


def known_of(words: Sequence[str]) -> dict[str, float]:
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
                f"--known '{shortened(word)}': expected NAME.PARAMETER=NUMBER, such as "
                "payload.mass=2.8 or coulomb.2.level=8."
            )
    return out


def check_declared(names: Sequence[str] | None) -> None:
    """Refuse names in --declared that no effect has."""
    for name in names or ():
        check_name(name, registry(), "effect in --declared")
