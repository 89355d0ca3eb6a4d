"""Logs of an arm as files, many of them in seconds."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.synthetic.logs import standard_case
from residual.recording import Recording
from residual.robot.robot import built_in_folder

_NAMES = ["t", *(f"{signal}{j}" for signal in ("q", "tau") for j in range(1, 7))]


def arm(folder: Path) -> Path:
    """Put the URDF of an IRB140 into a folder, without its robot.toml."""
    urdf = folder / "arm.urdf"
    source = built_in_folder("irb140") / "irb140.urdf"
    urdf.write_text(source.read_text(encoding="utf-8"), encoding="utf-8")
    return urdf


def logs(folder: Path, seed: int = 1) -> list[Path]:
    """Write three logs of an arm with a load on its flange."""
    case = standard_case("payload", seed, joint=6)
    return [write(folder / f"{log.id}.csv", log) for log in case.fit[:3]]


def many(folder: Path, number: int, seconds: float) -> list[Path]:
    """Write many short logs, each with samples of its own.

    Args:
        seconds: Length of each [s].
    """
    case = standard_case("payload", 1, joint=6)
    whole = [log for log in case.fit if log.duration > seconds]
    rng, paths = np.random.default_rng(7), []
    for k in range(number):
        log = whole[k % len(whole)]
        start = rng.uniform(0.0, log.duration - seconds)
        rows = (log.t >= log.t[0] + start) & (log.t < log.t[0] + start + seconds)
        noise = rng.normal(0.0, 0.05, (rows.sum(), log.dof))
        part = replace(
            log,
            t=log.t[rows] - log.t[rows][0],
            q=log.q[rows],
            tau=log.tau[rows] + noise,
            qd=None,
            qdd=None,
            q_ref=None,
        )
        paths.append(write(folder / f"log_{k:04}.csv", part))
    return paths


def write(path: Path, log: Recording) -> Path:
    """Write a log as CSV."""
    rows = np.column_stack([log.t, log.q, log.tau])
    head = ",".join(_NAMES)
    np.savetxt(path, rows, "%.6f", delimiter=",", header=head, comments="")
    return path
