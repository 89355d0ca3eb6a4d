"""A designed motion on the simulated arm of some runs, and all logs diagnosed."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from flows.outputs import Progress
from flows.requests import Diagnose
from flows.settings import store_folder
from flows.specs.experiment import ExperimentSpec, TrajectoryTable
from flows.steps import experiment
from flows.steps.diagnose import diagnose_runs
from flows.steps.rerun import spec_of
from residual.errors import InputError
from residual.planning.question import PAUSE
from sim.engine.records import TrajectorySpec
from warehouse.layout import find_run
from warehouse.runs import has_seal, open_seal, read_manifest, robot_word


def execute(request: Diagnose, motion: TrajectorySpec) -> str:
    """Run a motion on the arm that the runs of a diagnosis are of, and store it.

    The arm is made from the sealed half of a run, which nothing but the simulation is
    told; it goes on in the session of the runs.

    Args:
        request: The diagnosis; its logs are ids of runs.

    Raises:
        InputError: If the runs are of no simulated arm, or its seal is not there.
    """
    store = store_folder(request.store)
    return experiment.run(next_spec(store, request, motion), store)


def next_spec(store: Path, request: Diagnose, motion: TrajectorySpec) -> ExperimentSpec:
    """Return the experiment of a motion after some runs.

    Raises:
        InputError: As of `execute`.
    """
    ids = [find_run(store, id).id for id in (*request.logs, *request.held_out)]
    manifests = [read_manifest(store, id) for id in ids]
    _check_simulated(store, ids, manifests)
    first = manifests[0]
    word = robot_word(store, first["robot"], first.get("robot_hash"))
    spec = spec_of({**first, "robot": word}, open_seal(store, ids[0]).spec)
    ends = [m["spec"]["start"] + m["spec"]["trajectory"]["duration"] for m in manifests]
    table = TrajectoryTable.model_validate(asdict(motion))
    return spec.model_copy(update={"trajectory": table, "start": max(ends) + PAUSE})


def settle(
    request: Diagnose, run_id: str, progress: Progress | None = None
) -> tuple[str, str]:
    """Diagnose the runs of a diagnosis with one more.

    Returns:
        The ids of the new diagnosis and of its proof.
    """
    logs = tuple(dict.fromkeys((*request.logs, run_id)))
    return diagnose_runs(replace(request, logs=logs), progress)


def _check_simulated(
    store: Path, ids: Sequence[str], manifests: Sequence[dict]
) -> None:
    for id, manifest in zip(ids, manifests, strict=True):
        if not manifest.get("sealed_sha256"):
            raise InputError(
                f"Run {id} is a measured log, so nothing here can move its arm. Write "
                "the motion with --out, run it on the robot, and diagnose its log "
                "together with the others."
            )
        if not has_seal(store, id):
            raise InputError(
                f"The sealed half of run {id} is not in the store: its arm cannot be "
                "made again. Use a store that has it."
            )
