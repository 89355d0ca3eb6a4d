"""From runs in the store to a verdict in the store: ids in, ids out."""

from dataclasses import asdict, dataclass
from pathlib import Path

from flows.inputs.robots import load
from flows.keep.diagnosis import store_outcome
from flows.steps.diagnose import Progress


@dataclass(frozen=True, slots=True)
class Study:
    """Which runs are diagnosed, and against which.

    Attributes:
        robot: Built-in name, URDF file or folder.
        fit: Ids of the runs to diagnose.
        held_out: Ids of the runs for the proof.
        baseline: Ids of runs of the arm in good order.
        declared: Effects that the model has; None for the robot's own list.
    """

    robot: str
    fit: tuple[str, ...]
    held_out: tuple[str, ...] = ()
    baseline: tuple[str, ...] = ()
    declared: tuple[str, ...] | None = None

    @property
    def parents(self) -> dict[str, list[str]]:
        """Ids by role, for the lineage."""
        roles = {
            "fit": self.fit,
            "held_out": self.held_out,
            "baseline": self.baseline,
        }
        return {role: list(ids) for role, ids in roles.items() if ids}


def diagnose(
    study: Study, store: Path, progress: Progress | None = None
) -> tuple[str, str]:
    """Identify, diagnose, augment and validate on runs; store the verdict.

    Nothing but the runs is read, so the verdict is the same without `sealed/`.

    Args:
        study: Which runs.
        store: The store.
        progress: Told the stage and the share done.

    Returns:
        The ids of the diagnosis, and of the validation that has its curves.

    Raises:
        InputError: If a run is not there or does not belong to the robot.
    """
    from threadpoolctl import threadpool_limits

    from flows.steps.null import nulls_in
    from residual.close import close_the_loop
    from warehouse.runs import read_run

    robot = load(study.robot)
    logs = {
        role: [read_run(store, id) for id in ids] for role, ids in study.parents.items()
    }
    # One thread: the products are small, two threads only wait for each other.
    with threadpool_limits(1, user_api="blas"):
        outcome = close_the_loop(
            robot,
            logs["fit"],
            baseline=logs.get("baseline", ()),
            held_out=logs.get("held_out", ()),
            declared=study.declared,
            progress=progress,
            null=nulls_in(store),
        )
    request = {
        "step": "diagnose",
        **asdict(study),
        "robot_hash": robot.content_hash,
    }
    return store_outcome(store, outcome, study.parents, request)
