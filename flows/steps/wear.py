"""Follow the friction of a robot over its runs: wear, told from warming up."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from flows.inputs.given import load_of
from flows.outputs import Progress
from flows.steps.models import choose
from flows.storage.diagnosis import read_known
from residual.errors import InputError
from residual.identification.identify import identify
from residual.lazy import one_blas_thread
from residual.model.model import Model
from residual.monitoring.wear import (
    JointTrend,
    LogFriction,
    friction_of_each,
    sessions,
    trends,
)
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from warehouse.query.store import ask
from warehouse.runs import read_run

PAUSE = 2 * 3600.0  # s without a log: the arm is cold again, a new session begins
DAY = 86400.0  # s
MOST = 200  # runs, the latest: two seconds of work or so for every ten


@dataclass(frozen=True, slots=True)
class Wear:
    """What the friction of a robot did."""

    robot: str
    # Which model it was held against; None for one identified from the runs.
    line: str | None
    clock: str  # what the time within a session is taken from
    time: float  # time constant of warming up [s]
    joints: Sequence[JointTrend]  # what each joint does
    runs: Sequence[str]  # ids of the runs, the first one first
    # Of each run: days since the first, and time since its session began [s]. Shapes
    # (n,).
    days: Array
    sessions: Array
    # Friction of each joint relative to the model's. Shapes (n, dof).
    change: Array
    sd: Array


@one_blas_thread
def follow(
    store: Path,
    word: str,
    runs: Sequence[str] = (),
    model: str | None = None,
    progress: Progress | None = None,
) -> Wear:
    """Return what the friction of a robot does from day to day and within the day.

    Args:
        runs: Ids of runs; all of the robot, the latest 200, where none is given.
        model: Value of --model, None for the adopted model or one of the runs' own.
    """
    robot = load_of(word, runs, store)
    listed = _listed(store, robot, runs)
    choice = choose(robot, model, store, [id for id, _, _ in listed])
    logs = [read_run(store, id) for id, _, _ in listed]
    if choice.diagnosis:
        known = read_known(store, choice.diagnosis)
    else:
        known = identify(robot, logs).model
    seen = _seen(robot, logs, known, progress)
    days, since, clock = _times(listed, logs)
    change = np.array([one.change for one in seen])
    joints, time = trends(change, days, since)
    sd = np.array([one.sd for one in seen])
    ids = tuple(log.id for log in logs)
    return Wear(
        robot.name, choice.line, clock, time, joints, ids, days, since, change, sd
    )


def _seen(
    robot: Robot, logs: Sequence[Recording], known: Model, progress: Progress | None
) -> list[LogFriction]:
    def told(done: int) -> None:
        if progress:
            progress("friction of each run", done / len(logs))

    return friction_of_each(robot, logs, known, told)


def _listed(store: Path, robot: Robot, runs: Sequence[str]) -> list[tuple]:
    """Id, recording time and creation of the runs, in the order of their creation."""
    query = """SELECT run_id, recorded_at, created FROM runs
               WHERE robot = $robot AND serial IS NOT DISTINCT FROM $serial
               ORDER BY created DESC, run_id"""
    rows = ask(store, query, robot=robot.name, serial=robot.serial)
    found = [(r["run_id"], r["recorded_at"], r["created"]) for r in rows]
    if runs:
        found = [row for row in found if any(row[0].startswith(id) for id in runs)]
        missing = [id for id in runs if not any(row[0].startswith(id) for row in found)]
        if missing:
            raise InputError(
                f"{', '.join(missing)} is no run of {robot.name} in {store}. "
                "modelgap runs lists them."
            )
    if not found:
        raise InputError(
            f"{store} has no run of {robot.name}: modelgap import brings logs in."
        )
    return found[:MOST][::-1]


def _times(
    listed: Sequence[tuple], logs: Sequence[Recording]
) -> tuple[Array, Array, str]:
    """Days since the first log, time since its session began, and by which clock."""
    own = np.array([(log.t[0] + log.t[-1]) / 2 for log in logs])
    if all(recorded is not None for _, recorded, _ in listed):
        begins = np.array([_seconds(recorded) for _, recorded, _ in listed])
        ends = begins + [log.t[-1] - log.t[0] for log in logs]
        began = sessions(begins, ends, PAUSE)
        return (begins - begins.min()) / DAY, (begins + ends) / 2 - began, "recorded_at"
    made = np.array([_seconds(r if r else c) for _, r, c in listed])
    return (made - made.min()) / DAY, own, "the logs' own times"


def _seconds(moment: datetime) -> float:
    return moment.replace(tzinfo=moment.tzinfo or UTC).timestamp()
