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
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.check_parts.arms import SIGNALS, Host, Spoiled, Table, table_of
from flows.inputs.given import LogSets, read_sets
from flows.steps.check import check
from residual.check.motion import Motion, thin_rows
from residual.check.result import Fault, LogCheck
from residual.recording import Recording
from residual.robot.dynamics import inertial_parameters, regressor
from residual.robot.robot import Robot, robot_from_texts

# A repair that says what was done is right to rounding; a fitted one is not.
_EXACT = {"torque_scale": 0.03}
_ROUNDING = 1e-3


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
        right["gravity"] = bool(np.allclose(mended, wanted, _ROUNDING))
    columns = folder / "COLUMNS.toml"
    columns.write_text("\n".join(lines.values()), encoding="utf-8")
    logs = read(folder, spoiled.tables, robot, str(columns)).fit
    tables, most = list(map(table_of, logs)), _EXACT.get(spoiled.kind, _ROUNDING)
    for name in tables[0]:
        pairs = zip(tables, spoiled.right, strict=False)
        same = [_same(mended[name], good[name], most) for mended, good in pairs]
        right["time" if name == "t" else name] = bool(same) and all(same)
    left = [right[name] for name in right if name not in (*lines, "gravity")]
    return [
        all(left) and all(right[line.partition(" =")[0]] for line in r.splitlines())
        for r in repairs
    ]


def _same(mended: np.ndarray, right: np.ndarray, most: float) -> bool:
    if mended.shape != right.shape:
        return False
    if mended.ndim == 1:  # where a clock begins is of no account
        mended, right = mended - mended[0], right - right[0]
    size = np.sqrt(np.mean(right**2, axis=0)) + 1e-9
    return bool((np.sqrt(np.mean((mended - right) ** 2, axis=0)) / size).max() <= most)


Array = np.ndarray

# Strict, so that what any witness sees faintly counts: odds of e^5 that noise and error
# of the fit to the clean log did it, and half of what the file misses.
NATS, FILE = 5.0, 0.5
KINDS = ("torque_scale", "delay")
_ROUNDS, _RANK, _LEAST = 4, 1e-6, 1e-3
_OWN = 6  # columns of each joint's friction and rotor


@dataclass(frozen=True, eq=False, slots=True)
class Trace:
    """What the witnesses see of a change."""

    others: float  # evidence of it beside any body and any friction [nats]
    # Its size over what the robot file misses of the clean torque, both beside any
    # friction, of the joint where that is largest
    file: float

    @property
    def void(self) -> bool:
        """Whether there is none."""
        return self.others < NATS and self.file < FILE


def trace(host: Host, spoiled: Spoiled) -> Trace | None:
    """Return what a fault of the torque leaves; None of other kinds or without rows."""
    clean = thin_rows(host.logs) if spoiled.kind in KINDS else None
    if clean is None:
        return None
    logs = [
        Recording(log.id, log.robot, table["t"], log.q, table["tau"], log.qd)
        for log, table in zip(host.logs, spoiled.tables, strict=True)
    ]
    bodies = regressor(host.robot.model, clean.q, clean.qd, clean.qdd)
    friction = [_friction(clean, j) for j in range(clean.dof)]
    fitted, left, basis = _fit(clean, bodies, friction)
    if spoiled.kind == "torque_scale":
        # The noise is no trace: of the torque that the fit explains, the factor's part.
        change = fitted * (_factors(logs, host.logs) - 1)
    else:
        change = thin_rows(logs).tau - clean.tau
    weighed = (change / left).ravel()
    seen = weighed - basis @ (basis.T @ weighed)
    misses = clean.tau - bodies @ inertial_parameters(host.robot.model)
    sizes = [
        np.linalg.norm(_beside(own, change[:, j]))
        / max(np.linalg.norm(_beside(own, misses[:, j])), 1e-12)
        for j, own in enumerate(friction)
    ]
    return Trace(float(0.5 * clean.spread * seen @ seen), float(max(sizes)))


def _factors(logs: Sequence[Recording], clean: Sequence[Recording]) -> Array:
    a, b = (np.concatenate([log.tau for log in each]) for each in (logs, clean))
    return np.sum(a * b, axis=0) / np.sum(b * b, axis=0)


def _friction(motion: Motion, joint: int) -> Array:
    """Friction in several forms, an offset and a rotor. Shape (n, 6)."""
    qd = motion.qd[:, joint]
    speed = max(float(qd.std()), 1e-9)
    parts = [np.ones_like(qd), qd, np.tanh(qd / (0.05 * speed)), np.abs(qd)]
    return np.column_stack([*parts, np.abs(qd) * qd, motion.qdd[:, joint]])


def _fit(
    motion: Motion, bodies: Array, friction: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Fit any body and any friction to all torques, each by what is left of it.

    Returns:
        The torque that it explains (n, dof), the rms that it leaves of each joint
        (dof,), and an orthonormal basis of all that it could, in units of that.
    """
    n, dof = motion.tau.shape
    own = np.zeros((n, dof, _OWN * dof))
    for j, part in enumerate(friction):
        own[:, j, _OWN * j : _OWN * (j + 1)] = part
    design = np.concatenate([bodies, own], axis=2)
    design = design / np.maximum(np.sqrt(np.mean(design**2, axis=(0, 1))), 1e-12)
    size = np.sqrt(np.mean(motion.tau**2, axis=0)) + 1e-12
    left = 0.1 * size
    for _ in range(_ROUNDS):
        rows = (design / left[:, None]).reshape(n * dof, -1)
        at = np.linalg.lstsq(rows, (motion.tau / left).ravel(), rcond=_RANK)[0]
        fitted = design @ at
        rest = np.sqrt(np.mean((motion.tau - fitted) ** 2, axis=0))
        left = np.maximum(rest, _LEAST * size)
    vectors, values, _ = np.linalg.svd(rows, full_matrices=False)
    return fitted, left, vectors[:, values > _RANK * values[0]]


def _beside(own: Array, x: Array) -> Array:
    """What a joint's own friction cannot take up."""
    return x - own @ np.linalg.lstsq(own, x, rcond=None)[0]
