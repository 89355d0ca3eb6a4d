"""What a watch knows: what is usual, where the stream is, and rows for a diagnosis."""

import io
import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated
from zipfile import BadZipFile

import numpy as np
from cyclopts import Parameter

from flows.inputs.given import load
from flows.outputs import write_all
from flows.requests import GivenWord, Request, Store, Words
from flows.settings import store_folder
from flows.steps.models import Choice, choose, source_of
from flows.steps.monitor import usable_runs
from residual.errors import InputError
from residual.lazy import one_blas_thread
from residual.monitoring.learn import PER_HOUR, learn
from residual.monitoring.monitor import LEAST_RUNS
from residual.monitoring.reference import Reference
from residual.monitoring.rows import Samples
from residual.monitoring.watch import (
    Change,
    State,
    begin,
    state_from_record,
    state_to_record,
    step,
)
from residual.robot.robot import Robot
from warehouse.files import sync
from warehouse.runs import read_run

BEFORE, AFTER = 5.0, 20.0  # s around an alarm that are diagnosed
FORM = 2


@dataclass(frozen=True, slots=True)
class Origin:
    """What a reference was learnt from."""

    robot: str
    robot_hash: str  # hash of its description
    # Id of the diagnosis whose model expects the torque; None for the nominal one.
    diagnosis: str | None
    good: tuple[str, ...]  # ids of the healthy runs


@dataclass(frozen=True, eq=False, slots=True)
class Session:
    """A watch at one moment."""

    origin: Origin  # what its reference was learnt from
    reference: Reference  # what is usual
    state: State  # state of the stream
    # Samples since some seconds before the first alarm that is not diagnosed yet, or
    # the last seconds.
    recent: Samples
    waiting: tuple[Change, ...] = ()  # alarms that wait for samples to be diagnosed
    position: dict | None = None  # where the source goes on


def advance(session: Session, samples: Samples) -> tuple[Session, tuple[Change, ...]]:
    """Look at new samples; keep those that a diagnosis may need."""
    state, alarms = step(session.reference, session.state, samples)
    recent = _usable(_joined(session.recent, samples))
    if not session.waiting and not alarms and len(recent.t):
        recent = recent[recent.t >= recent.t[-1] - 2 * BEFORE]
    waiting = (*session.waiting, *alarms)
    return replace(session, state=state, recent=recent, waiting=waiting), alarms


def due(session: Session, last: bool = False) -> bool:
    """Return whether the first alarm has all samples that its diagnosis is to have."""
    if not session.waiting or not len(session.recent.t):
        return False
    return last or session.recent.t[-1] >= session.waiting[0].time + AFTER


def around(session: Session) -> Samples:
    """Return the samples of the first waiting alarm: since what it saw began."""
    alarm = session.waiting[0]
    start = alarm.time - min(alarm.motion, BEFORE)
    t = session.recent.t
    return session.recent[(t >= start) & (t <= alarm.time + AFTER)]


def settled(session: Session) -> Session:
    """Return the session without the alarms of the same rows as the first."""
    alarm = session.waiting[0]
    later = tuple(a for a in session.waiting if a.time > alarm.time + AFTER)
    return replace(session, waiting=later)


def _joined(one: Samples, other: Samples) -> Samples:
    names = ("t", "q", "tau")
    return Samples(
        *(np.concatenate([getattr(one, n), getattr(other, n)]) for n in names)
    )


def _usable(samples: Samples) -> Samples:
    """Samples that are numbers, since the clock was set back the last time."""
    whole = np.isfinite(np.column_stack([samples.t, samples.q, samples.tau])).all(1)
    samples = samples[whole]
    back = np.flatnonzero(np.diff(samples.t) <= 0)
    return samples[int(back[-1]) + 1 :] if len(back) else samples


def write(path: Path, session: Session) -> None:
    """Keep a watch in a file, whole or not at all."""
    about = {
        "form": FORM,
        "origin": asdict(session.origin),
        "reference": session.reference.to_record(),
        "state": state_to_record(session.state),
        "waiting": [asdict(alarm) for alarm in session.waiting],
        "position": session.position,
    }
    packed = io.BytesIO()
    recent = session.recent
    text = np.array(json.dumps(about))
    np.savez(packed, about=text, t=recent.t, q=recent.q, tau=recent.tau)
    write_all({path: packed.getvalue()})
    sync(path.parent)


def read(path: Path) -> Session | None:
    """Return the watch of a file; None where there is none."""
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as kept:
            about = json.loads(str(kept["about"]))
            recent = Samples(kept["t"], kept["q"], kept["tau"])
        if about["form"] != FORM:
            raise InputError(f"form {about['form']}")
        origin = about["origin"]
        return Session(
            origin=Origin(**origin | {"good": tuple(origin["good"])}),
            reference=Reference.from_record(about["reference"]),
            state=state_from_record(about["state"]),
            recent=recent,
            waiting=tuple(Change(**each) for each in about["waiting"]),
            position=about["position"],
        )
    except (OSError, ValueError, KeyError, TypeError, BadZipFile, InputError) as error:
        raise InputError(
            f"{path} is no state of this version of modelgap watch ({error}). Name "
            "another with --state, or delete it to begin anew."
        ) from error


STATES = "_watch"  # folder of states in the store


@dataclass(frozen=True, slots=True)
class Watch(Request):
    """What is watched while it runs.

    Attributes:
        robot: Built-in name, URDF file or folder. It goes by the model that it has in
            the store (modelgap models).
        good: Ids of healthy runs, three or more, such as will be watched, cold and
            warm. Needed once: the state remembers what was learnt.
        model: "nominal", or the id of a diagnosis, in place of the model that it has.
        per_hour: False alarms wanted at most in an hour.
        state: File of the state; without it one in the store.
    """

    robot: GivenWord = ""
    good: Annotated[Words, Parameter(name="--calibrate")] = ()
    model: str | None = None
    per_hour: float = PER_HOUR
    state: str | None = None
    store: Store = None


@dataclass(frozen=True, eq=False, slots=True)
class Begun:
    """A watch that may begin."""

    robot: Robot
    session: Session
    path: Path
    lines: tuple[str, ...]


def start(request: Watch) -> Begun:
    """Go on with a watch, or learn from healthy runs what is usual.

    What was learnt goes by one model; where the robot has another now, it is learnt
    again, and the source is read on.
    """
    store, robot = store_folder(request.store), load(request.robot)
    choice = choose(robot, request.model, store)
    path = _path(request, store, robot)
    before = read(path)
    if before and before.origin.robot_hash != robot.content_hash:
        raise InputError(
            f"{path} is of {before.origin.robot} as it was described then. Delete it "
            "to begin anew, or put the description back."
        )
    good = _good(request, store, choice, before)
    origin = Origin(robot.name, robot.content_hash, choice.diagnosis, good)
    if before and before.origin == origin:
        return Begun(robot, before, path, (*choice.lines, _going_on(before)))
    reference = _learnt(request, store, robot, origin)
    state, position = begin(reference), before.position if before else None
    session = Session(origin, reference, state, state.tail.kept, (), position)
    again = ("model or healthy runs are others than before: learnt again",)
    lines = (*choice.lines, *(again if before else ()), _learnt_from(session))
    return Begun(robot, session, path, lines)


def _path(request: Watch, store: Path, robot: Robot) -> Path:
    if request.state is not None:
        path = Path(request.state)
        if not path.parent.is_dir():
            raise InputError(f"--state {path}: there is no folder {path.parent}.")
        return path
    folder = store / STATES
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    serial = f"-{robot.serial}" if robot.serial else ""
    return folder / f"{robot.name}{serial}.npz"


def _good(
    request: Watch, store: Path, choice: Choice, before: Session | None
) -> tuple[str, ...]:
    if request.good:
        return tuple(usable_runs(store, request.good))
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
def _learnt(request: Watch, store: Path, robot: Robot, origin: Origin):
    source = source_of(origin.diagnosis or request.robot, store)
    runs = [read_run(store, id) for id in origin.good]
    for run in runs:
        source.robot_of(run, store)
    return learn(source.model_of(robot, runs), runs, request.per_hour)


def _learnt_from(session: Session) -> str:
    minutes, count = 60 * session.reference.hours, len(session.origin.good)
    limits = session.reference.limits
    return (
        f"learnt from {count} healthy runs, {minutes:.3g} min; an alarm needs "
        f"{limits.min():.2g} to {limits.max():.2g} nats of evidence"
    )


def _going_on(session: Session) -> str:
    counts = session.state.tail.heard
    minutes = session.state.moved / session.reference.window.row_rate / 60
    return (
        f"going on after {counts.samples} samples, {minutes:.3g} min of motion and "
        f"{session.state.alarms} alarms"
    )
