"""Runs of a real robot that no diagnosis has taken yet: one diagnosis for all of them.

What a diagnosis took stands in the store, as a record of kind "batch" with the runs as
parents. So nothing is taken twice or forgotten, whoever is killed when: without the
record the same runs are diagnosed again, to the same id.
"""

import fcntl
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flows.project.read import Project, RobotTable
from flows.requests import Diagnose
from flows.settings import prefect_home
from flows.steps.diagnose import diagnose_runs, request_of
from flows.steps.models import in_force
from flows.storage.diagnosis import read_verdict
from residual.diagnosis.result import Verdict
from residual.robot.robot import Robot
from warehouse.commit import commit_record
from warehouse.query.store import query_store

KIND = ROLE = "batch"
_PROOF = 3  # of so many logs one is held out for the proof
_QUERY = """
    SELECT run_id, list_contains(coalesce(tags, []), $healthy) AS healthy,
           run_id IN (SELECT parent FROM lineage WHERE role = $role) AS taken,
           run_id IN (SELECT parent FROM lineage WHERE role = 'watched') AS watched
    FROM runs
    WHERE robot = $robot AND serial IS NOT DISTINCT FROM $serial
          AND source = 'imported' AND NOT quarantined
    ORDER BY coalesce(recorded_at, created), run_id
"""

_WHOSE = """
    SELECT DISTINCT robot, serial, source FROM runs WHERE list_contains($runs, run_id)
"""


@dataclass(frozen=True, slots=True)
class Batch:
    """Runs that are diagnosed together."""

    # All runs that no diagnosis has taken, in the order of their time.
    runs: tuple[str, ...]
    # All of them, or as many as are taken, spread over them; one is held out where
    # there are enough. Against the model that the robot has, else its healthy runs.
    request: Diagnose
    unwatched: tuple[str, ...] = ()  # those of them that no monitoring has seen

    @property
    def against(self) -> str:
        """What they are diagnosed against, in words."""
        if self.request.model:
            return f"the adopted model, of diagnosis {self.request.model[:8]}"
        if self.request.baseline:
            return f"{len(self.request.baseline)} healthy runs"
        return "the model as described"


@dataclass(frozen=True, slots=True)
class BatchDiagnosis:
    """What a batch of runs was diagnosed with."""

    batch: Batch
    ids: tuple[str, str]
    verdict: Verdict


def new_runs(store: Path, arm: Robot, table: RobotTable) -> Batch | None:
    """Return what there is to diagnose of a robot, None for nothing."""
    if not store.is_dir():
        return None
    about = {"robot": arm.name, "serial": arm.serial, "healthy": table.healthy}
    rows = query_store(store, _QUERY, **about, role=ROLE)
    healthy = [row["run_id"] for row in rows if row["healthy"]]
    new = [row for row in rows if not row["taken"] and not row["healthy"]]
    runs = [row["run_id"] for row in new]
    if not runs:
        return None
    chosen = spread(runs, table.most)
    proof = chosen[-1:] if len(chosen) >= _PROOF else []
    model = in_force(chosen, store).diagnosis
    roles = {
        "fit": [run for run in chosen if run not in proof],
        "held_out": proof,
        "baseline": () if model else healthy[-table.most :],
    }
    unwatched = tuple(row["run_id"] for row in new if not row["watched"])
    return Batch(tuple(runs), request_of(roles, store, model), unwatched)


def spread(runs: Sequence[str], most: int) -> list[str]:
    """Return so many runs at most, spread over all, the first and the last too."""
    if len(runs) <= most:
        return list(runs)
    places = np.linspace(0, len(runs) - 1, most).round().astype(int)
    return [runs[place] for place in places]


def diagnose_new(
    project: Project, name: str, progress: Callable[[str, float], None] | None = None
) -> BatchDiagnosis | None:
    """Diagnose what has come in of a robot since the last time; None where nothing has.

    Raises:
        InputError: If the runs are not usable together, or their robot is not.
    """
    table, store = project.robot(name), project.store
    arm = project.arm(table)
    with _locked(store, name):
        batch = new_runs(store, arm, table)
        if batch is None:
            return None
        ids = diagnose_runs(batch.request, progress)
        record = {"robot": arm.name, "serial": arm.serial, "kind": KIND}
        parents = {"diagnosis": [ids[0]], ROLE: list(batch.runs)}
        commit_record(store, "validations", record | {"project": name}, parents=parents)
    return BatchDiagnosis(batch, ids, read_verdict(store, ids[0]))


@contextmanager
def _locked(store: Path, name: str) -> Iterator[None]:
    """Wait until nobody else diagnoses what is new of a robot.

    A schedule, logs that were stored and an alarm of theirs may ask at once: the first
    takes all that is new, the others then find nothing.
    """
    with (prefect_home(store) / f"diagnose-{name}.lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def robot_of_runs(project: Project, runs: Sequence[str]) -> RobotTable | None:
    """Return the real robot that measured runs are of; None where they are of none."""
    rows = query_store(project.store, _WHOSE, runs=list(runs))
    for table in project.table.robot:
        if table.simulated or len(rows) != 1:
            continue
        arm = project.arm(table)
        if rows == [{"robot": arm.name, "serial": arm.serial, "source": "imported"}]:
            return table
    return None
