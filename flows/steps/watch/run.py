"""The loop of a watch: read, step, tell, keep; nothing is lost at any kill."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from flows.inputs.stream import GrowingFile, StandardInput
from flows.requests import Diagnose
from flows.steps.imports import about_log
from flows.steps.watch.session import (
    Session,
    advance,
    around,
    due,
    settled,
    write,
)
from residual.monitoring.rows import Heard, Samples
from residual.monitoring.watch import Change
from residual.recording import Recording
from residual.robot.robot import Robot
from warehouse.commit import commit_record, commit_run
from warehouse.runs import keep_robot
from warehouse.schema import rows_table

SAVE = 5.0  # s between two times that the state is kept
ENDS = 3  # looks in a row with nothing new after which all that is there was read

Tell = Callable[[str], None]
Diagnosing = Callable[[Session, Samples, Change], None]


@dataclass(frozen=True, slots=True)
class Shell:
    """What a watch is connected to."""

    source: GrowingFile | StandardInput
    path: Path
    tell: Tell
    alarmed: Callable[[Change], None]
    diagnose: Diagnosing


def watch(session: Session, shell: Shell, once: bool = False) -> Session:
    """Watch until interrupted, or until all that is there was read."""
    saved, idle = time.monotonic(), 0
    try:
        while not (shell.source.ended or (once and idle >= ENDS)):
            session, new, more = _look(session, shell)
            idle = 0 if new else idle + 1
            if due(session):
                session = _diagnosed(session, shell)
            elif time.monotonic() - saved > SAVE:
                write(shell.path, session)
                saved = time.monotonic()
            if not (more or shell.source.ended):
                shell.source.wait()
        while due(session, last=True):
            session = _diagnosed(session, shell)
    finally:
        write(shell.path, session)
    return session


def _look(session: Session, shell: Shell) -> tuple[Session, bool, bool]:
    """Read once; return the session, whether there was news, and whether is more."""
    batch = shell.source.read()
    for note in batch.notes:
        shell.tell(note)
    if batch.samples is None:
        new = bool(batch.notes) or batch.more
        session = replace(session, position=shell.source.position())
        return session, new, batch.more
    before = session.state.tail.heard
    session, alarms = advance(session, batch.samples)
    # The state and the place that it belongs to, in one record.
    session = replace(session, position=shell.source.position())
    for line in said_of(before, session.state.tail.heard):
        shell.tell(line)
    for alarm in alarms:
        shell.alarmed(alarm)
    if alarms:
        write(shell.path, session)
    return session, True, batch.more


def _diagnosed(session: Session, shell: Shell) -> Session:
    """Diagnose the first waiting alarm; it waits no more once that is stored."""
    shell.diagnose(session, around(session), session.waiting[0])
    session = settled(session)
    write(shell.path, session)
    return session


_WORDS = {
    "broken": "samples without a number in every column were left out",
    "late": "samples at a time that was before were left out",
    "gaps": "gaps in time; what is filtered begins anew behind each",
    "restarts": "times the clock was set back; it goes on from there",
}


def said_of(before: Heard, now: Heard) -> list[str]:
    """Return what has been wrong with the samples of a batch, a line each."""
    old, new = asdict(before), asdict(now)
    return [
        f"{new[key] - old[key]} {words}"
        for key, words in _WORDS.items()
        if new[key] > old[key]
    ]


ENOUGH = 8.0  # s of samples that a diagnosis needs
KIND = "watch"
TAG = "alarm"


def keep_run(store: Path, word: str, robot: Robot, samples: Samples) -> str:
    """Put the samples around an alarm into the store as a run."""
    recording = Recording(
        "watched", robot.name, samples.t - samples.t[0], samples.q, samples.tau
    )
    keep_robot(store, word, robot)
    stream = {"file": "stream", "begin": float(samples.t[0])}
    return commit_run(store, recording, about_log(robot, KIND, stream, tags=[TAG]))


def keep_alarm(
    store: Path, session: Session, run: str, begin: float, alarm: Change
) -> str:
    """Put an alarm into the store: a validation with its row in `alarms`.

    Args:
        begin: Time on the stream's clock at which that run begins [s].
    """
    origin = session.origin
    record = {
        "robot": origin.robot,
        "kind": KIND,
        "model_id": None,
        "alarm": asdict(alarm),
        "run_begins": begin,
        "heard": asdict(session.state.tail.heard),
    }
    at = alarm.time - begin
    row = {
        "run_id": run,
        "time": at,
        "joint": alarm.joint,
        "sensor": "torque",
        "fault": alarm.quantity,
        "kind": "change",
        "score": alarm.score,
        "until": at,
    }
    table = rows_table("alarms", [row])
    parents = {"calibration": list(origin.good), "watched": [run]}
    if origin.diagnosis:
        parents["diagnosis"] = [origin.diagnosis]
    return commit_record(store, "validations", record, {"alarms": table}, parents)


def request_of(session: Session, run: str, word: str, store: Path) -> Diagnose:
    """Return the diagnosis that an alarm asks for.

    Against the model that was watched by; where that is the nominal one, against the
    healthy runs, so that it is said what has changed since.
    """
    origin = session.origin
    baseline = () if origin.diagnosis else origin.good
    return Diagnose(
        logs=(run,),
        robot=word,
        baseline=baseline,
        store=store,
        model=origin.diagnosis,
    )


def long_enough(samples: Samples) -> bool:
    """Return whether samples are enough for a diagnosis."""
    return len(samples.t) > 1 and float(np.ptp(samples.t)) >= ENOUGH
