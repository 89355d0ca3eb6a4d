"""What a check says of spoiled logs: right kind and joints, and lines that mend.

Whether a fault leaves a trace at all is told by the clean log and the fault alone. Two
witnesses can tell of a change in the torque. The other joints: no body and no friction
that is fitted to all torques carries it. The robot file: it is larger than what the
file misses of the clean torque anyway. What neither can see is no fault of the log: a
wrist whose torque is friction, times a factor, is a wrist of other friction.
"""

import json
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.check_parts.arms import SIGNALS, Host, Spoiled, Table, table_of
from flows.inputs.read import LogSets, read_sets
from flows.steps.check import check
from residual.check.result import Fault, LogCheck
from residual.robot.robot import Robot, robot_from_texts

_ROUNDING = 1e-3
_TURNED = 0.052  # of gravity: 3 degrees


def judged(own: Host, spoiled: Spoiled) -> dict:
    """Check spoiled logs; return what was said, and what that is worth."""
    with tempfile.TemporaryDirectory() as folder:
        place, robot = Path(folder), given(own, spoiled)
        sets = read(place, spoiled.tables, robot)
        begun = perf_counter()
        report = check(sets)
        seconds = round(perf_counter() - begun, 3)
        repairs = list(dict.fromkeys(f.repair for f in report.faults if f.repair))
        exact = _exact(repairs, spoiled, own, robot, place)
    return {
        **told(report),
        "hit": any(is_it(f, spoiled, own.robot.dof) for f in report.faults),
        "certain": any(f.certain for f in report.faults),
        "exact": exact,
        "seconds": seconds,
    }


def given(own: Host, spoiled: Spoiled) -> Robot:
    """Return the robot as it is given with spoiled logs."""
    toml = json.loads(own.robot.toml) | tomllib.loads(spoiled.toml)
    urdf = spoiled.urdf or own.robot.urdf
    return robot_from_texts(own.robot.name, urdf, json.dumps(toml, sort_keys=True))


def read(
    folder: Path, tables: Sequence[Table], robot: Robot, columns: str | None = None
) -> LogSets:
    """Write logs as files and read them as a command does."""
    words = []
    for i, table in enumerate(tables):
        names = {"t": table["t"]}
        for signal in (*SIGNALS[1:], "q_ref"):
            if signal in table:
                names |= {f"{signal}{j}": c for j, c in enumerate(table[signal].T, 1)}
        path = folder / f"log_{i}.parquet"
        pq.write_table(pa.table(names), path)
        words.append(str(path))
    return read_sets((words, (), ()), robot, columns, folder, to_check=True)


def told(report: LogCheck) -> dict:
    """Return what a check said, short."""
    return {
        "verdict": report.verdict,
        "said": [[f.kind, list(f.joints), f.certain] for f in report.faults],
    }


def is_it(fault: Fault, spoiled: Spoiled, dof: int) -> bool:
    """Whether a fault is the one that was made: kind and joints."""
    every = tuple(range(1, dof + 1))
    where = tuple(sorted(fault.joints)) or every
    kinds = (spoiled.kind, *spoiled.also)
    return fault.kind in kinds and where == (spoiled.joints or every)


def _exact(
    repairs: Sequence[str], spoiled: Spoiled, own: Host, robot: Robot, folder: Path
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
        wanted = own.robot.model.gravity.linear
        miss = np.linalg.norm(np.subtract(mended, wanted))
        right["gravity"] = bool(miss < _TURNED * np.linalg.norm(wanted))
    columns = folder / "COLUMNS.toml"
    columns.write_text("\n".join(lines.values()), encoding="utf-8")
    logs = read(folder, spoiled.tables, robot, str(columns)).fit
    tables = list(map(table_of, logs))
    for name in tables[0]:
        pairs = zip(tables, spoiled.right, strict=False)
        same = [_same(mended[name], good[name]) for mended, good in pairs]
        right["time" if name == "t" else name] = bool(same) and all(same)
    left = [right[name] for name in right if name not in (*lines, "gravity")]
    return [
        all(left) and all(right[line.partition(" =")[0]] for line in r.splitlines())
        for r in repairs
    ]


def _same(mended: np.ndarray, right: np.ndarray) -> bool:
    if mended.shape != right.shape:
        return False
    if mended.ndim == 1:  # where a clock begins is of no account
        mended, right = mended - mended[0], right - right[0]
    size = np.sqrt(np.mean(right**2, axis=0)) + 1e-9
    return bool(
        (np.sqrt(np.mean((mended - right) ** 2, axis=0)) / size).max() <= _ROUNDING
    )
