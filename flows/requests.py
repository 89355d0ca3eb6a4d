"""What a user wants of each verb, in his own words: one frozen record per verb.

Of what is stored, the record of its request says how to make it again; where things
are (store, map of columns, file of a null) is no part of that.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Self

_PLACES = ("columns", "null", "store")
_FORMERLY = {"fit": "logs"}  # keys of records of 0.1.0


class Request:
    """A verb and what it is to be done with."""

    __slots__ = ()

    def to_record(self) -> dict:
        """Return the request as JSON can hold it: the verb as `step`, no places."""
        names = [f.name for f in fields(self) if f.name not in _PLACES]
        step = type(self).__name__.lower()
        return {"step": step} | {name: getattr(self, name) for name in names}

    @classmethod
    def from_record(cls, record: Mapping, store: Path) -> Self:
        """Return the request that `to_record` was called on, for another store.

        Args:
            record: The record; what is no part of the request is left alone.
            store: Where its runs are, and where what is made is kept.
        """
        record = {_FORMERLY.get(key, key): value for key, value in record.items()}
        known = {f.name for f in fields(cls)} & set(record)
        values = {name: record[name] for name in known}
        lists = {k: tuple(v) for k, v in values.items() if isinstance(v, list)}
        return cls(**values | lists, store=store)


@dataclass(frozen=True, slots=True)
class Check(Request):
    """Which logs are checked.

    Attributes:
        logs: Logs: "FILE", "FILE@start:end", or the id of a run.
        robot: Built-in name, URDF file or folder.
        declared: Effects that the model has; None for the robot's own list.
        columns: COLUMNS.toml, None for the default columns.
        store: Folder of the store, None for the usual one.
    """

    logs: tuple[str, ...]
    robot: str
    declared: tuple[str, ...] | None = None
    columns: str | None = None
    store: str | Path | None = None


@dataclass(frozen=True, slots=True)
class Diagnose(Request):
    """Which logs are diagnosed, and against which.

    Attributes:
        logs: Logs to diagnose: "FILE", "FILE@start:end", or the id of a run.
        robot: Built-in name, URDF file or folder.
        held_out: Logs for the proof; empty for the last quarter of the longest.
        baseline: Logs of healthy runs of the robot.
        declared: Effects that the model has; None for the robot's own list.
        columns: COLUMNS.toml, None for the default columns.
        null: File of a calibrated null; None for those of the store.
        store: Folder of the store, None for the usual one.
        trust_log: Whether to go on where a fault of the logs is certain.
        model: Id of the diagnosis whose model was adopted: then what changed since the
            runs behind it is named; None for no such.
    """

    logs: tuple[str, ...]
    robot: str
    held_out: tuple[str, ...] = ()
    baseline: tuple[str, ...] = ()
    declared: tuple[str, ...] | None = None
    columns: str | None = None
    null: str | None = None
    store: str | Path | None = None
    trust_log: bool = False
    model: str | None = None


@dataclass(frozen=True, slots=True)
class Identify(Request):
    """Which logs a model is identified from, and how.

    Attributes:
        logs: Logs to fit: "FILE", "FILE@start:end", or the id of a run.
        robot: Built-in name, URDF file or folder.
        held_out: Logs for the proof; empty for the last quarter of the longest.
        declared: Effects that the model has; None for the robot's own list.
        method: "ols", "wls" or "irls".
        prior: Relative scale of the nominal prior, None for a free fit.
        essential: Whether to drop parameters that are not needed.
        consistent: Whether to find physically consistent parameters too.
        columns: COLUMNS.toml, None for the default columns.
        store: Folder of the store, None for the usual one.
        trust_log: Whether to go on where a fault of the logs is certain.
        model: Id of the diagnosis whose model it starts from; None for the nominal one.
    """

    logs: tuple[str, ...]
    robot: str
    held_out: tuple[str, ...] = ()
    declared: tuple[str, ...] | None = None
    method: str = "wls"
    prior: float | None = None
    essential: bool = False
    consistent: bool = False
    columns: str | None = None
    store: str | Path | None = None
    trust_log: bool = False
    model: str | None = None


@dataclass(frozen=True, slots=True)
class Calibrate(Request):
    """Which logs look-up tables are fitted to.

    Attributes:
        logs: Logs: "FILE", "FILE@start:end", or the id of a run.
        robot: Built-in name, URDF file or folder.
        paper: The paper's regressors and twin error.
        declared: Effects that the model has; None for the robot's own list.
        columns: COLUMNS.toml, None for the default columns.
        store: Folder of the store, None for the usual one.
        trust_log: Whether to go on where a fault of the logs is certain.
        levels: Levels of the paper's form: one number, or one for each variable; None
            to choose them.
        components: Its components: exactly so many with `levels`, else at most.
        joints: Joints of X and Y, from 1; None for all, or the paper's.
        model: Id of the diagnosis whose named effects it has; None for the latest.
    """

    logs: tuple[str, ...]
    robot: str
    paper: bool = False
    declared: tuple[str, ...] | None = None
    columns: str | None = None
    store: str | Path | None = None
    trust_log: bool = False
    levels: tuple[int, ...] | None = None
    components: int | None = None
    joints: tuple[int, ...] | None = None
    model: str | None = None


@dataclass(frozen=True, slots=True)
class Null(Request):
    """Which logs the false-alarm rate of a diagnosis is found for.

    Attributes:
        logs: Logs: "FILE", "FILE@start:end", or ids of runs.
        robot: Built-in name, URDF file or folder.
        declared: Effects that the model has; None for the robot's own list.
        columns: COLUMNS.toml, None for the default columns.
        draws: How many draws.
        seed: Seed of the draws.
        store: Folder of the store, None for the usual one.
    """

    logs: tuple[str, ...]
    robot: str
    declared: tuple[str, ...] | None = None
    columns: str | None = None
    draws: int = 200
    seed: int = 0
    store: str | Path | None = None


@dataclass(frozen=True, slots=True)
class Import(Request):
    """Which logs become runs of the store.

    Attributes:
        logs: Logs: "FILE" or "FILE@start:end".
        robot: Built-in name, URDF file or folder.
        columns: COLUMNS.toml, None for the default columns.
        trajectory: What kind of motion it was, for queries; None for no word.
        kind: What it was recorded for.
        store: Folder of the store, None for the usual one.
        trust_log: Whether to go on where a fault of the logs is certain.
        serial: Serial number of the arm; None for that of robot.toml, or none.
        tags: Words, or "KEY=VALUE".
        recorded_at: When the first sample was taken, ISO 8601 with a zone; None for
            what the log says, or unknown.
    """

    logs: tuple[str, ...]
    robot: str
    columns: str | None = None
    trajectory: str | None = None
    kind: str = "log"
    store: str | Path | None = None
    trust_log: bool = False
    serial: str | None = None
    tags: tuple[str, ...] = ()
    recorded_at: str | None = None


@dataclass(frozen=True, slots=True)
class Validate(Request):
    """Which run the nominal model is tried on.

    Attributes:
        run: Id of the run, or its beginning.
        window: Length of the windows of the open loop [s].
        store: Folder of the store, None for the usual one.
    """

    run: str
    window: float = 0.25
    store: str | Path | None = None


@dataclass(frozen=True, slots=True)
class Monitor(Request):
    """Which runs are watched, and by which.

    Attributes:
        model: Id of a diagnosis, or a robot for its nominal model.
        runs: Ids of the runs to watch.
        good: Ids of the healthy runs; empty for those of the diagnosis.
        per_hour: False alarms wanted at most [1/h].
        store: Folder of the store, None for the usual one.
    """

    model: str
    runs: tuple[str, ...]
    good: tuple[str, ...] = ()
    per_hour: float = 1.0
    store: str | Path | None = None


@dataclass(frozen=True, slots=True)
class Campaign(Request):
    """Many experiments of one file.

    Attributes:
        path: The campaign file.
        held_out: Kind of motion of the runs that are held out; "" for none.
        seed: Replaces the seed of the file; None for that one.
        runner: Where it is computed; None for the usual place (`flows.workers.runner`).
        trust_network: Whether that may be on other machines.
        store: Folder of the store, None for the usual one.
    """

    path: str
    held_out: str = ""
    seed: int | None = None
    runner: str | None = None
    trust_network: bool = False
    store: str | Path | None = None


@dataclass(frozen=True, slots=True)
class Demo(Request):
    """Which demonstration.

    Attributes:
        seed: Seed of everything: arm, effect, motions, noise.
        effect: Effect to hide; None to draw it, "none" to hide nothing.
        store: Folder of the store, None for the usual one.
        background: What all joints have beside it: clean, workshop or worn.
    """

    seed: int
    effect: str | None = None
    store: str | Path | None = None
    background: str = "clean"


@dataclass(frozen=True, slots=True)
class Export(Request):
    """Which model is written in the form of which program.

    Attributes:
        model: Id of a diagnosis or model, or a file that holds a model.
        to: The target.
        which: Which model of a diagnosis; None for the augmented one.
        log: A log to show, "FILE", "FILE@start:end" or the id of a run; None for none.
        columns: COLUMNS.toml of the log, None for the default columns.
        store: Folder of the store, None for the usual one.
    """

    model: str
    to: str
    which: str | None = None
    log: str | None = None
    columns: str | None = None
    store: str | Path | None = None
