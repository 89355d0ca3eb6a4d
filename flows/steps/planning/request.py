"""What a user wants of the next experiment."""

from dataclasses import dataclass
from pathlib import Path

from flows.requests import Request


@dataclass(frozen=True, slots=True)
class Next(Request):
    """For which verdict or wish a motion is designed.

    Attributes:
        verdict: Id of a diagnosis in the store, or a JSON file with a verdict.
        logs: Logs of that verdict, where it is a file: "FILE", "FILE@start:end", or
            the id of a run.
        robot: Built-in name, URDF file or folder; None for that of a stored diagnosis.
        held_out: Its logs for the proof.
        baseline: Its logs of healthy runs.
        want: An effect that is to be seen, as "payload>=0.5"; None for what is open.
        seconds: Length of the motion [s].
        seed: Seed of the search.
        columns: COLUMNS.toml, None for the default columns.
        store: Folder of the store, None for the usual one.
    """

    verdict: str
    logs: tuple[str, ...] = ()
    robot: str | None = None
    held_out: tuple[str, ...] = ()
    baseline: tuple[str, ...] = ()
    want: str | None = None
    seconds: float = 20.0
    seed: int = 0
    columns: str | None = None
    store: str | Path | None = None
