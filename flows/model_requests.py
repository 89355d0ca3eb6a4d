"""What a user wants of a model, beside what `flows.requests` has."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Predict:
    """Which model is asked for its torque, and on which logs.

    Attributes:
        logs: Logs: "FILE", "FILE@start:end", or the id of a run.
        model: Id of a diagnosis or model, or a file that holds a model.
        which: Which model of a diagnosis; None for the augmented one.
        without: Effects to take out of it: "NAME" or "NAME@JOINT".
        columns: COLUMNS.toml, None for the default columns.
        store: Folder of the store, None for the usual one.
    """

    logs: tuple[str, ...]
    model: str
    which: str | None = None
    without: tuple[str, ...] = ()
    columns: str | None = None
    store: str | Path | None = None


@dataclass(frozen=True, slots=True)
class View:
    """Which log is looked at, and with which model beside it.

    Attributes:
        log: "FILE", "FILE@start:end", or the id of a run.
        robot: Built-in name, URDF file or folder; None for that of the run.
        verdict: Id of a diagnosis, whose models and findings are shown; None for the
            model of the robot as described.
        columns: COLUMNS.toml, None for the default columns.
        store: Folder of the store, None for the usual one.
    """

    log: str
    robot: str | None = None
    verdict: str | None = None
    columns: str | None = None
    store: str | Path | None = None
