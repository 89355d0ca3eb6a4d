"""Compare what a check reports of faulty logs with the fault, and try its repairs."""

import json
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.check_parts.arms import SIGNALS, FaultyLogs, Host, Table, table_of
from flows.inputs import LogSets, read_log_sets
from flows.steps.check import check_log_sets
from residual.check.result import Fault, LogCheck
from residual.robot.robot import Robot, build_robot

_ROUNDING = 1e-3
_TURNED = 0.052  # of gravity: 3 degrees


def compare(arm: Host, faulty: FaultyLogs) -> dict:
    """Check faulty logs; return the report compared with the fault."""
    with tempfile.TemporaryDirectory() as folder:
        place, robot = Path(folder), given_robot(arm, faulty)
        sets = read(place, faulty.tables, robot)
        begun = perf_counter()
        report = check_log_sets(sets)
        seconds = round(perf_counter() - begun, 3)
        repairs = list(dict.fromkeys(f.repair[0] for f in report.faults if f.repair))
        exact = _exact(repairs, faulty, arm, robot, place)
    return {
        **reported(report),
        "hit": all(
            any(is_it(f, each, arm.robot.dof) for f in report.faults)
            for each in (faulty, faulty.beside)
            if each is not None
        ),
        "certain": any(f.certain for f in report.faults),
        "exact": exact,
        "seconds": seconds,
    }


def given_robot(arm: Host, faulty: FaultyLogs) -> Robot:
    toml = json.loads(arm.robot.toml) | tomllib.loads(faulty.toml)
    urdf = faulty.urdf or arm.robot.urdf
    return build_robot(arm.robot.name, urdf, json.dumps(toml, sort_keys=True))


def read(
    folder: Path, tables: Sequence[Table], robot: Robot, columns: str | None = None
) -> LogSets:
    words = []
    for i, table in enumerate(tables):
        names = {"t": table["t"]}
        for signal in (*SIGNALS[1:], "q_ref"):
            if signal in table:
                names |= {f"{signal}{j}": c for j, c in enumerate(table[signal].T, 1)}
        path = folder / f"log_{i}.parquet"
        pq.write_table(pa.table(names), path)
        words.append(str(path))
    return read_log_sets((words, (), ()), robot, columns, folder, to_check=True)


def reported(report: LogCheck) -> dict:
    return {
        "verdict": report.verdict,
        "said": [[f.kind, list(f.joints), f.certain] for f in report.faults],
    }


def is_it(fault: Fault, faulty: FaultyLogs, dof: int) -> bool:
    every = tuple(range(1, dof + 1))
    where = tuple(sorted(fault.joints)) or every
    if faulty.joints:
        where = tuple(j for j in where if j in faulty.joints or j not in faulty.may)
    kinds = (faulty.kind, *faulty.also)
    return fault.kind in kinds and where == (faulty.joints or every)


def _exact(
    repairs: Sequence[str], faulty: FaultyLogs, arm: Host, robot: Robot, folder: Path
) -> list[bool]:
    """Whether logs, or the robot, are the right ones once the lines are followed.

    All are followed together, as a user would. A repair is exact if every signal that
    it names is what it was before the fault, and every signal that no line names too:
    one that mends half of a fault is not.
    """
    lines = {
        line.partition(" =")[0]: line
        for repair in reversed(repairs)
        for line in repair.splitlines()
    }
    right, gravity = {"gravity": False}, lines.pop("gravity", None)
    if gravity is not None:
        mended = tomllib.loads(gravity)["gravity"]
        wanted = arm.robot.model.gravity.linear
        miss = np.linalg.norm(np.subtract(mended, wanted))
        right["gravity"] = bool(miss < _TURNED * np.linalg.norm(wanted))
    columns = folder / "COLUMNS.toml"
    columns.write_text("\n".join(lines.values()), encoding="utf-8")
    logs = read(folder, faulty.tables, robot, str(columns)).fit
    tables = list(map(table_of, logs))
    for name in tables[0]:
        pairs = zip(tables, faulty.right, strict=False)
        same = [_is_equal(mended[name], good[name]) for mended, good in pairs]
        right["time" if name == "t" else name] = bool(same) and all(same)
    left = [right[name] for name in right if name not in (*lines, "gravity")]
    return [
        all(left) and all(right[line.partition(" =")[0]] for line in r.splitlines())
        for r in repairs
    ]


def _is_equal(mended: np.ndarray, right: np.ndarray) -> bool:
    if mended.shape != right.shape:
        return False
    if mended.ndim == 1:  # where a clock begins is of no account
        mended, right = mended - mended[0], right - right[0]
    size = np.sqrt(np.mean(right**2, axis=0)) + 1e-9
    rms = np.sqrt(np.mean((mended - right) ** 2, axis=0))
    return bool((rms / size).max() <= _ROUNDING)
