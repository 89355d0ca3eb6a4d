"""What an alarm starts: its rows become a run, and that is diagnosed."""

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pyarrow as pa

from flows.requests import Diagnose
from flows.steps.watch.session import Session
from residual.monitoring.rows import Samples
from residual.monitoring.watch import Change
from residual.recording import Recording
from residual.robot.robot import Robot
from warehouse.commit import commit_record, commit_run
from warehouse.robots import keep_robot
from warehouse.schema import VIEWS

ENOUGH = 8.0  # s of samples that a diagnosis needs
KIND = "watch"
TAG = "alarm"


def keep_run(store: Path, word: str, robot: Robot, samples: Samples) -> str:
    """Put the samples around an alarm into the store as a run.

    Args:
        samples: The samples, in order.
    """
    recording = Recording(
        "watched", robot.name, samples.t - samples.t[0], samples.q, samples.tau
    )
    keep_robot(store, word, robot)
    about = {"file": "stream", "begin": float(samples.t[0])}
    manifest = {
        "source": "imported",
        "kind": KIND,
        "trajectory": None,
        "robot_hash": robot.content_hash,
        "serial": robot.serial,
        "recorded_at": None,
        "tags": [TAG],
        "log": about,
    }
    return commit_run(store, recording, manifest)


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
    fields = [c.field for c in VIEWS["alarms"] if c.name in row]
    table = pa.Table.from_pylist([row], schema=pa.schema(fields))
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
