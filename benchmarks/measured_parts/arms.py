"""Logs of real arms, split into fit and held out, and two peers on them.

Plain least squares is the usual complete robot model,

    tau = Y theta + Jr qdd + Fv qd + Fc sign(qd) + offset

with the full inertial regressor and four parameters per joint; it needs the kinematics
only. PLSR is the paper's. Filter, edges and error are those of the diagnosis.
"""

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks.harness.origin import ROOT
from benchmarks.measured_parts import greedy
from residual.calibration.nominal_pls import fit_nominal_pls
from residual.diagnosis.diagnose import diagnose
from residual.recording import Recording
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import Robot, build_robot, load_robot
from residual.signals.track import FilterSettings, Track, build_tracks
from warehouse.logs import read_column_map, read_log

Array = np.ndarray

# Singular values of the normalised columns below this share are not identified.
_RANK = 1e-6


def peer_errors(
    robot: Robot, fit: list[Recording], held_out: list[Recording]
) -> tuple[Array, Array]:
    """Return held-out errors of least squares and of PLSR by joint [%]. (dof,) each.

    100 ||tau - tau_hat|| / ||tau||, both sides filtered, edges dropped. PLSR: tables
    of q, qd and qdd on the torque that the rigid body of the robot file misses.
    """
    tracks, speed_floor = build_tracks(fit, FilterSettings())
    proof, _ = build_tracks(held_out, FilterSettings(), speed_floor, full_rate=True)
    x, tau = _rows(robot, tracks)
    x_proof, tau_proof = _rows(robot, proof)
    x = x.reshape(-1, x.shape[2])
    scale = np.linalg.norm(x, axis=0)
    scale[scale == 0] = 1.0
    theta = np.linalg.lstsq(x / scale, tau.ravel(), rcond=_RANK)[0] / scale
    miss = tau_proof - x_proof @ theta
    states, torque = _states(robot, tracks)
    tables = fit_nominal_pls(states, torque)
    states_proof, torque_proof = _states(robot, proof)
    left = torque_proof - tables.predict(states_proof)
    size = np.linalg.norm(tau_proof, axis=0)
    return tuple(100 * np.linalg.norm(each, axis=0) / size for each in (miss, left))


def _states(robot: Robot, tracks: tuple[Track, ...]) -> tuple[Array, Array]:
    """Return q, qd, qdd (n, 3 dof) and torque beyond the rigid body (n, dof)."""
    states, torque = [], []
    for track in tracks:
        motion = (track.q, track.qd, track.qdd)
        rigid = track.filter(compute_inverse_dynamics(robot.model, *motion))
        states.append(np.hstack([x[:: track.step] for x in motion])[track.valid])
        torque.append((track.tau - rigid)[track.valid])
    return np.concatenate(states), np.concatenate(torque)


def _rows(robot: Robot, tracks: tuple[Track, ...]) -> tuple[Array, Array]:
    """Return filtered columns (n, dof, p) and torque (n, dof) outside the edges."""
    columns = [greedy.base_columns(robot, track, 0.0)[track.valid] for track in tracks]
    return np.concatenate(columns), np.concatenate([t.tau[t.valid] for t in tracks])


KR300, UR10, UR10E, LWR4, GEN3 = "kr300", "ur10", "ur10e", "lwr4", "gen3"
XMATE3, LBRMED, TIAGO, KRANG = "xmate3", "lbrmed", "tiago", "krang"
# What the README of the logs says of the torque's signs and of gravity [m/s^2].
SIGNS = {LBRMED: (-1,) * 7}  # in TIAGo's run_nm they are right
GRAVITY = {KRANG: [0, -9.81, 0]}
DAYS = ("feb05", "feb06", "feb10", "feb12", "feb19")
LOADED = "ur10e feb19 -> feb19_load"
# Of the Gen3: which columns are the currents of the motors, which the torque sensors.
CURRENT, SENSOR = "current.toml", "sensor.toml"


@dataclass(frozen=True, slots=True)
class Split:
    """Logs of one arm, by its folder; with a window where it is a part of a file."""

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


def _exchanged(arm: str, run: str, at: str) -> dict[str, Split]:
    """Two parts of one run, each held out in turn."""
    first, second = (f"{run}.csv@:{at}",), (f"{run}.csv@{at}:",)
    return {
        f"{arm} {run} :{at} | {at}:": Split(arm, first, second),
        f"{arm} {run} {at}: | :{at}": Split(arm, second, first),
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
    **_exchanged(XMATE3, "run", "60%"),
    **_exchanged(XMATE3, "motor", "60%"),
    **_exchanged(LBRMED, "run", "50%"),
    **_exchanged(TIAGO, "run_nm", "60%"),
    "krang train | test": Split(KRANG, ("train.csv",), ("test.csv",)),
    "krang test | train": Split(KRANG, ("test.csv",), ("train.csv",)),
}


def data_folder() -> Path | None:
    """Return the folder of measured logs, None where it is not there."""
    folder = Path(os.environ.get("MODELGAP_DATA") or ROOT.parent / "shared" / "data")
    return folder if (folder / KR300 / "kr300.urdf").exists() else None


def absent(arm: str) -> bool:
    folder = data_folder()
    return folder is None or not (folder / arm).is_dir()


def folder_of(arm: str) -> Path:
    folder = data_folder()
    assert folder is not None
    return folder / arm


@lru_cache(maxsize=8)
def robot_of(arm: str) -> Robot:
    if arm in (XMATE3, LBRMED, TIAGO, KRANG):
        urdf = (folder_of(arm) / "robot.urdf").read_text(encoding="utf-8")
        # A placeholder, as the README of the logs says.
        urdf = urdf.replace('velocity="0.1"', 'velocity="10"')
        gravity = GRAVITY.get(arm, [0, 0, -9.81])
        return build_robot(arm, urdf, json.dumps({"robot": {"gravity": gravity}}))
    return load_robot(folder_of(arm) / f"{arm}.urdf")


def read_logs(arm: str, files: Iterable[str], columns: str = CURRENT) -> list[Recording]:
    """Read files of an arm, or windows of them, by its COLUMNS.toml if it has one."""
    known = folder_of(arm) / columns
    read = read_column_map(known) if known.exists() else None
    logs = [read_log(f"{folder_of(arm) / f}", robot_of(arm), read)[0] for f in files]
    signs = np.array(SIGNS.get(arm, 1.0))
    return [replace(log, tau=signs * log.tau) for log in logs]


def read_split(split: Split) -> tuple[Robot, dict[str, list[Recording]]]:
    return robot_of(split.arm), {
        role: read_logs(split.arm, getattr(split, role), SENSOR)
        for role in ("fit", "held_out", "baseline")
    }


def measure(name: str) -> dict:
    """Diagnose one split; beside it the errors of plain least squares [%]."""
    robot, logs = read_split(SPLITS[name])
    begun = process_time()
    verdict = diagnose(robot, **logs).verdict
    seconds = process_time() - begun
    errors, found = verdict.error, verdict.effects
    peer = plsr = None
    if logs["held_out"]:
        both = peer_errors(robot, logs["fit"], logs["held_out"])
        peer, plsr = (each.tolist() for each in both)
    return {
        "split": name,
        "named": [[e.name, list(e.joints)] for e in found],
        "alike": [[[a.name, list(a.joints)] for a in e.equivalent] for e in found],
        "mass": [p.value for e in found for k, p in e.parameters.items() if k == "mass"],
        "verdict": verdict.verdict,
        "filtered": {k: v for k, v in errors.filtered.items() if v is not None},
        "moving": {k: v for k, v in errors.moving.items() if v is not None},
        "peer": peer,
        "plsr": plsr,
        "worse": list(errors.worse),
        "seconds": round(seconds, 1),
    }


def same_logs(one: str, other: str) -> bool:
    """Whether two splits are of the same arm and torque, both without a load."""
    heads = [name.split(" | ")[0].split() for name in (one, other)]
    logs = [h[:2] if h[1] in ("run", "motor", "run_nm") else h[:1] for h in heads]
    return logs[0] == logs[1] and LOADED not in (one, other)
