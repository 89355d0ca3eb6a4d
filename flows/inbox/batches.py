"""One diagnosis for all new runs of a real robot.

A record of kind "batch" in the store has the diagnosed runs as parents. After a kill
before that record, the same runs are diagnosed again, with the same id.
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
from flows.steps.diagnose import build_diagnose_request, diagnose_stored_runs
from flows.steps.model_choice import resolve_adopted_model
from flows.storage.diagnosis import read_verdict
from residual.robot.robot import Robot
from residual.verdict.result import Verdict
from warehouse.query.store import query_store_rows
from warehouse.record_commit import commit_record

KIND = ROLE = "batch"
_PROOF = 3  # from this number of logs on, one is held out
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

    runs: tuple[str, ...]  # all new runs, in the order of their time
    # On all of them, or on a limited number spread over them; compared with the adopted
    # model, else with the healthy runs.
    request: Diagnose
    unwatched: tuple[str, ...] = ()  # new runs without monitoring

    @property
    def against(self) -> str:
        """Text: the model or the runs that they are compared with."""
        if self.request.model:
            return f"the adopted model, of diagnosis {self.request.model[:8]}"
        if self.request.baseline:
            return f"{len(self.request.baseline)} healthy runs"
        return "the model as described"


@dataclass(frozen=True, slots=True)
class BatchDiagnosis:
    """The diagnosis of a batch."""

    batch: Batch
    ids: tuple[str, str]
    verdict: Verdict


def find_new_runs(store: Path, robot: Robot, table: RobotTable) -> Batch | None:
    """Return the new runs of a robot, None if there are none."""
    if not store.is_dir():
        return None
    about = {"robot": robot.name, "serial": robot.serial, "healthy": table.healthy}
    rows = query_store_rows(store, _QUERY, **about, role=ROLE)
    healthy = [row["run_id"] for row in rows if row["healthy"]]
    new = [row for row in rows if not row["taken"] and not row["healthy"]]
    runs = [row["run_id"] for row in new]
    if not runs:
        return None
    chosen = pick_evenly_spread(runs, table.most)
    proof = chosen[-1:] if len(chosen) >= _PROOF else []
    model = resolve_adopted_model(chosen, store).diagnosis
    roles = {
        "fit": [run for run in chosen if run not in proof],
        "held_out": proof,
        "baseline": () if model else healthy[-table.most :],
    }
    unwatched = tuple(row["run_id"] for row in new if not row["watched"])
    return Batch(tuple(runs), build_diagnose_request(roles, store, model), unwatched)


def pick_evenly_spread(runs: Sequence[str], max_count: int) -> list[str]:
    """Return at most a number of runs, evenly spread, with the first and the last."""
    if len(runs) <= max_count:
        return list(runs)
    places = np.linspace(0, len(runs) - 1, max_count).round().astype(int)
    return [runs[place] for place in places]


def diagnose_new_runs(
    project: Project, name: str, progress: Callable[[str, float], None] | None = None
) -> BatchDiagnosis | None:
    """Diagnose the new runs of a robot; None if there are none.

    Raises:
        InputError: If the runs are not usable together, or their robot is not.
    """
    table, store = project.robot(name), project.store
    arm = project.arm(table)
    with _locked(store, name):
        batch = find_new_runs(store, arm, table)
        if batch is None:
            return None
        ids = diagnose_stored_runs(batch.request, progress)
        record = {"robot": arm.name, "serial": arm.serial, "kind": KIND}
        parents = {"diagnosis": [ids[0]], ROLE: list(batch.runs)}
        commit_record(store, "validations", record | {"project": name}, parents=parents)
    return BatchDiagnosis(batch, ids, read_verdict(store, ids[0]))


@contextmanager
def _locked(store: Path, name: str) -> Iterator[None]:
    """Wait for other diagnoses of the robot.

    Schedule, import and alarm may start one at the same time: the first takes all new
    runs, the others find none.
    """
    with (prefect_home(store) / f"diagnose-{name}.lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def find_project_robot(project: Project, runs: Sequence[str]) -> RobotTable | None:
    """Return the real robot that measured runs are of; None where they are of none."""
    rows = query_store_rows(project.store, _WHOSE, runs=list(runs))
    for table in project.table.robot:
        if table.simulated or len(rows) != 1:
            continue
        arm = project.arm(table)
        if rows == [{"robot": arm.name, "serial": arm.serial, "source": "imported"}]:
            return table
    return None
