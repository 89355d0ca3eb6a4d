"""Measured arms: orders of their logs as two epochs, and a plain fit of each arm."""

from functools import lru_cache
from itertools import combinations, permutations

import numpy as np

from benchmarks.changes_parts.arms import Part
from benchmarks.changes_parts.sizes import Body, moving, smooth
from benchmarks.measured_parts.arms import (
    DAYS,
    KR300,
    LWR4,
    UR10,
    UR10E,
    absent,
    folder_of,
    read_logs,
    robot_of,
)
from residual.recording import Recording
from residual.robot.dynamics import compute_inertial_regressor, read_inertial_parameters

ARMS = (UR10E, KR300, LWR4, UR10)
_RUNS = {KR300: ("run_A", "run_B", "run_C"), LWR4: ("run_1", "run_2", "run_3")}
_THIRD = 27.5 / 3  # s, of the log of the UR10
_LOADED = "feb19_load.csv"
LOAD_MASS = 2.805  # kg, as its owners weighed it
_RIDGE = 1e-4  # towards the description, of the size of a column

Epochs = tuple[str, tuple[Part, ...], tuple[Part, ...]]


def epochs(load: bool) -> list[Epochs]:
    """Return arm, first and second epoch of every order of days or runs.

    With a load: of the day with the weighed load against one day and two days without.
    Arms without logs on this machine are left out.
    """
    out: list[Epochs] = []
    if load:
        before, after = (_file("feb12"), _file("feb19")), (Part(_LOADED),)
        out = [(UR10E, before[1:], after), (UR10E, before, after)]
    else:
        for first in combinations(DAYS, 2):
            others = [day for day in DAYS if day not in first]
            parts = tuple(map(_file, first))
            out += [(UR10E, parts, (_file(day),)) for day in others]
        for arm, runs in _RUNS.items():
            logs = [_file(run) for run in runs]
            out += [(arm, (a,), (b,)) for a, b in permutations(logs, 2)]
        thirds = [Part("run.csv", 0, i * _THIRD, _THIRD) for i in range(3)]
        out += [(UR10, (a,), (b,)) for a, b in permutations(thirds, 2)]
    return [each for each in out if not absent(each[0])]


def _file(name: str) -> Part:
    return Part(f"{name}.csv")


@lru_cache(maxsize=64)
def read(arm: str, part: Part) -> Recording:
    window = ""
    if part.duration:
        window = f"@{part.start:.6f}:{part.start + part.duration:.6f}"
    return read_logs(arm, [f"{part.source}{window}"])[0]


@lru_cache(maxsize=4)
def plain_body(arm: str) -> Body:
    robot = robot_of(arm)
    dof, model = robot.dof, robot.model
    columns, torque, moves = [], [], []
    files = sorted(file.name for file in folder_of(arm).glob("*.csv"))
    for log in read_logs(arm, [name for name in files if name != _LOADED]):
        at = smooth(log)
        rows = slice(None, None, max(1, round(0.02 / (at.t[1] - at.t[0]))))
        own = (np.tanh(at.qd / 0.02), at.qd, at.qdd, np.ones_like(at.q))
        local = [each[rows, :, None] * np.eye(dof) for each in own]
        moved = (at.q[rows], at.qd[rows], at.qdd[rows])
        inertial = compute_inertial_regressor(model, *moved)
        columns.append(np.concatenate([inertial, *local], axis=2))
        torque.append(at.tau[rows])
        moves.append(moving(at)[rows])
    x, tau, kept = (np.concatenate(each) for each in (columns, torque, moves))
    rms = np.sqrt((tau**2).mean(axis=0))
    known = np.concatenate([read_inertial_parameters(model), np.zeros(4 * dof)])
    left = ((tau - x @ known) / rms)[kept]
    x = (x / rms[:, None])[kept]
    size = np.linalg.norm(x, axis=0) + 1e-9
    scaled = x / size
    gram = scaled.T @ scaled + _RIDGE * np.eye(len(size))
    found = known + np.linalg.solve(gram, scaled.T @ left) / size
    dry, viscous = np.split(found[10 * dof :], 4)[:2]
    return Body(robot, found[: 10 * dof], dry, viscous, rms)
