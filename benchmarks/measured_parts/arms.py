"""Logs of real arms, split into what is fitted and what is held out."""

import os
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks.figures import ROOT
from benchmarks.measured_parts.peer import peer_errors
from residual.close import close_the_loop
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot
from warehouse.logs import load_columns, read_log

KR300, UR10, UR10E, LWR4, GEN3 = "kr300", "ur10", "ur10e", "lwr4", "gen3"
DAYS = ("feb05", "feb06", "feb10", "feb12", "feb19")
LOADED = "ur10e feb19 -> feb19_load"
SENSOR = "sensor.toml"  # of the Gen3: which columns are the torque sensors


@dataclass(frozen=True, slots=True)
class Split:
    """Logs of one arm.

    Attributes:
        arm: Which one, as its folder is called.
        fit, held_out, baseline: Files, with a window where it is a part of one.
    """

    arm: str
    fit: tuple[str, ...]
    held_out: tuple[str, ...] = ()
    baseline: tuple[str, ...] = ()


def _rotations(arm: str, runs: str) -> dict[str, Split]:
    """Each run of an arm held out in turn."""
    files = {run: f"run_{run}.csv" for run in runs}
    return {
        f"{arm} {''.join(r for r in runs if r != out)} | {out}": Split(
            arm, tuple(f for r, f in files.items() if r != out), (files[out],)
        )
        for out in reversed(runs)
    }


SPLITS = {
    **_rotations(KR300, "ABC"),
    "ur10 60 % | 40 %": Split(UR10, ("run.csv@:60%",), ("run.csv@60%:",)),
    **{
        f"ur10e {day} | other days": Split(
            UR10E, (f"{day}.csv",), tuple(f"{d}.csv" for d in DAYS if d != day)
        )
        for day in DAYS
    },
    LOADED: Split(UR10E, ("feb19_load.csv",), (), ("feb19.csv",)),
    **_rotations(LWR4, "123"),
    "gen3 fourier_1 | fourier_2": Split(GEN3, ("fourier_1.csv",), ("fourier_2.csv",)),
}


def data_folder() -> Path | None:
    """Return the folder of measured logs, None where it is not there."""
    folder = Path(os.environ.get("MODELGAP_DATA") or ROOT.parent / "shared" / "data")
    return folder if (folder / KR300 / "kr300.urdf").exists() else None


def read_split(split: Split) -> tuple[Robot, dict[str, list[Recording]]]:
    """Return the robot of a split, and its logs by role."""
    folder = data_folder()
    assert folder is not None
    place = folder / split.arm
    robot = load_robot(place / f"{split.arm}.urdf")
    columns = load_columns(place / SENSOR) if split.arm == GEN3 else None
    return robot, {
        role: [
            read_log(str(place / f), robot, columns)[0] for f in getattr(split, role)
        ]
        for role in ("fit", "held_out", "baseline")
    }


def measure(name: str) -> dict:
    """Diagnose one split.

    Returns:
        What is named, errors on held-out motion [%] of each model and of plain least
        squares as anyone would write it, and the processor time it took [s].
    """
    robot, logs = read_split(SPLITS[name])
    begun = process_time()
    verdict = close_the_loop(robot, **logs).verdict
    seconds = process_time() - begun
    errors, found = verdict.error, verdict.effects
    peer = None
    if logs["held_out"]:
        peer = peer_errors(robot, logs["fit"], logs["held_out"])["ordinary"].tolist()
    return {
        "split": name,
        "named": [[e.name, list(e.joints)] for e in found],
        "alike": [
            [[a.name, list(a.joints)] for a in e.equivalent] for e in verdict.effects
        ],
        "mass": [
            p.value
            for e in verdict.effects
            for k, p in e.parameters.items()
            if k == "mass"
        ],
        "verdict": verdict.verdict,
        "filtered": {k: v for k, v in errors.filtered.items() if v is not None},
        "moving": {k: v for k, v in errors.moving.items() if v is not None},
        "peer": peer,
        "worse": list(errors.worse),
        "contradictions": list(verdict.contradictions),
        "seconds": round(seconds, 1),
    }


def over(after: list[float], before: list[float]) -> np.ndarray:
    """Errors over other errors, joint by joint. Shape (dof,)."""
    return np.array(after) / np.array(before)
