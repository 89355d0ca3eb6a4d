"""Begin a watch, or go on with one: which model, which healthy runs, which state."""

from dataclasses import dataclass
from pathlib import Path

from flows.inputs.robots import load
from flows.settings import store_folder
from flows.steps.loop.choose import Choice, Wanted, choose
from flows.steps.monitor_model import model_of, robot_of, source_of
from flows.steps.watch.session import Origin, Session, new_session, read
from residual.errors import InputError
from residual.monitoring.learn import PER_HOUR, learn
from residual.monitoring.monitor import LEAST_RUNS
from residual.robot.robot import Robot
from residual.threads import one_blas_thread
from warehouse.runs import read_run

STATES = "_watch"  # folder of states in the store


@dataclass(frozen=True, slots=True)
class Watch:
    """What is to be watched.

    Attributes:
        robot: Built-in name, URDF file or folder.
        good: Ids of healthy runs; empty for those of the model's diagnosis, or those
            of the state.
        model: "nominal", or the id of a diagnosis; None for what the robot has.
        per_hour: False alarms wanted at most [1/h].
        state: File of the state; None for one in the store.
        store: Folder of the store, None for the usual one.
    """

    robot: str
    good: tuple[str, ...] = ()
    model: str | None = None
    per_hour: float = PER_HOUR
    state: str | None = None
    store: str | Path | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Begun:
    """A watch that may begin.

    Attributes:
        robot: The arm.
        session: Where it goes on.
        path: File of its state.
        lines: What to say of it first.
    """

    robot: Robot
    session: Session
    path: Path
    lines: tuple[str, ...]


def start(asked: Watch) -> Begun:
    """Go on with a watch, or learn from healthy runs what is usual.

    What was learnt goes by one model; where the robot has another now, it is learnt
    again, and the source is read on.

    Raises:
        InputError: If there are too few healthy runs, or they are of another robot.
    """
    store, robot = store_folder(asked.store), load(asked.robot)
    choice = choose(robot, Wanted(asked.model, store))
    path = _path(asked, store, robot)
    before = read(path)
    if before and before.origin.robot_hash != robot.content_hash:
        raise InputError(
            f"{path} is of {before.origin.robot} as it was described then. Delete it "
            "to begin anew, or put the description back."
        )
    good = _good(asked, store, choice, before)
    origin = Origin(robot.name, robot.content_hash, choice.diagnosis, good)
    if before and before.origin == origin:
        return Begun(robot, before, path, (*choice.lines, _going_on(before)))
    session = _learnt(asked, store, robot, origin)
    session = new_session(origin, session, before.position if before else None)
    again = ("model or healthy runs are others than before: learnt again",)
    lines = (*choice.lines, *(again if before else ()), _learnt_from(session))
    return Begun(robot, session, path, lines)


def _path(asked: Watch, store: Path, robot: Robot) -> Path:
    if asked.state is not None:
        path = Path(asked.state)
        if not path.parent.is_dir():
            raise InputError(f"--state {path}: there is no folder {path.parent}.")
        return path
    folder = store / STATES
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    serial = f"-{robot.serial}" if robot.serial else ""
    return folder / f"{robot.name}{serial}.npz"


def _good(
    asked: Watch, store: Path, choice: Choice, before: Session | None
) -> tuple[str, ...]:
    if asked.good:
        return tuple(read_run(store, id).id for id in asked.good)
    if before:
        return before.origin.good
    good = source_of(choice.diagnosis, store).good if choice.diagnosis else ()
    if len(good) < LEAST_RUNS:
        raise InputError(
            f"{len(good)} healthy runs to learn from, expected at least {LEAST_RUNS}, "
            "such as will be watched, cold and warm. Import them and name them:\n"
            "modelgap watch ROBOT --calibrate RUN RUN RUN ..."
        )
    return good


@one_blas_thread
def _learnt(asked: Watch, store: Path, robot: Robot, origin: Origin):
    source = source_of(origin.diagnosis or asked.robot, store)
    runs = [read_run(store, id) for id in origin.good]
    for run in runs:
        robot_of(source, run, store)
    return learn(model_of(source, robot, runs), runs, asked.per_hour)


def _learnt_from(session: Session) -> str:
    minutes, count = 60 * session.reference.hours, len(session.origin.good)
    limits = session.reference.limits
    return (
        f"learnt from {count} healthy runs, {minutes:.3g} min; an alarm needs "
        f"{limits.min():.2g} to {limits.max():.2g} nats of evidence"
    )


def _going_on(session: Session) -> str:
    heard = session.state.tail.heard
    minutes = session.state.moved / session.reference.window.row_rate / 60
    return (
        f"going on after {heard.samples} samples, {minutes:.3g} min of motion and "
        f"{session.state.alarms} alarms"
    )
