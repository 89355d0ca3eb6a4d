"""New runs held against the model of their arm: what `modelgap inbox` does at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flows.requests import Monitor
from flows.steps.loop.choose import in_force
from flows.steps.monitor import latest_diagnosis, monitor
from flows.steps.monitor_model import source_of
from residual.monitoring.monitor import LEAST_RUNS


@dataclass(frozen=True, slots=True)
class Watched:
    """What the monitoring of new runs said.

    Attributes:
        record: Id of its record, None where there was nothing to compare with.
        alarmed: Runs with an alarm.
        why: Why nothing was watched, "" where it was.
    """

    record: str | None = None
    alarmed: tuple[str, ...] = ()
    why: str = ""


def watch_new(runs: Sequence[str], store: Path) -> Watched:
    """Watch new runs of one robot, against its adopted model or its last diagnosis.

    Raises:
        InputError: If a run is not usable, or of another description of the robot.
    """
    model = in_force(runs, store).diagnosis or latest_diagnosis(runs, store)
    if model is None:
        return Watched(why="no diagnosis of this arm yet: nothing to compare with")
    healthy = source_of(model, store).good
    new = tuple(run for run in runs if run not in healthy)
    if not new or len(healthy) < LEAST_RUNS:
        return Watched(why=f"{len(healthy)} healthy runs, {LEAST_RUNS} are the least")
    id, found, _ = monitor(Monitor(model, new, healthy, store=store))
    return Watched(id, tuple(run for run, alarms in found.alarms.items() if alarms))
