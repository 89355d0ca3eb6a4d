"""Measured arms: their logs cut into epochs, and what may be added to them."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import combinations, permutations

import numpy as np

from benchmarks.changes_parts import added, plant
from benchmarks.changes_parts.added import Body, moving, shares, size_of, smooth, solved
from benchmarks.changes_parts.case import Case, Part, Planted
from benchmarks.measured_parts.arms import (
    GEN3,
    KR300,
    LWR4,
    UR10,
    UR10E,
    folder_of,
    read_logs,
    robot_of,
)
from residual.recording import Recording
from residual.robot.dynamics import inertial_parameters, reach, regressor

Array = np.ndarray
Values = Mapping[str, float]
Rng = np.random.Generator

ARMS = (UR10E, KR300, LWR4, UR10, GEN3)
# Too short for a change of a known size: of the Gen3 only orders of its logs are made.
OTHERS = (KR300, LWR4, UR10)
# In the order in which they are dealt out on simulated arms.
EFFECTS = tuple(name for name in plant.EFFECTS if name in added.KNOWN)

# Seconds of every log, as they lie in the folder of measured logs.
_DAYS = {"feb05": 22.0, "feb06": 30.6, "feb10": 30.6, "feb12": 44.6, "feb19": 50.0}
_RUNS = {
    KR300: {"run_A": 10.0, "run_B": 10.0, "run_C": 10.0},
    LWR4: {"run_1": 25.1, "run_2": 25.1, "run_3": 25.1},
}
_UR10 = 27.5
_GEN3 = {"fourier_1": 4.7, "fourier_2": 2.2}
_LOADED, _LOADED_LENGTH = "feb19_load.csv", 50.0
LOAD_MASS = 2.805  # kg, as its owners weighed it
_EPOCH = (20.0, 50.0)  # s of the UR10e in one epoch
_RIDGE = 1e-4  # towards the description, of the size of a column
# What no arm has more of: of the torque's RMS (in 1/rad where it is a stiffness).
_OF_RMS = {"offset": 0.5, "ripple": 0.4, "spring": 1.0, "stribeck": 0.5}
_OF_OWN = {
    "coulomb": ("coulomb", -0.8, 4.0),
    "coulomb_asymmetry": ("coulomb", -0.9, 0.9),
    "viscous": ("viscous", -0.8, 4.0),
    "quadratic_viscous": ("viscous", 0.0, 4.0),
}
_LEAST_OWN = 0.02  # of the torque's RMS: a fit may find no friction at all


def _whole(file: str, length: float) -> Part:
    return Part(f"{file}.csv", 0, 0.0, length)


def unchanged_epochs() -> list[tuple[str, tuple[Part, ...], tuple[Part, ...]]]:
    """Return every order of days or runs: arm, first and second epoch."""
    out: list[tuple[str, tuple[Part, ...], tuple[Part, ...]]] = []
    days = [_whole(day, length) for day, length in _DAYS.items()]
    for many in (2, 3):
        for first in combinations(days, many):
            rest = tuple(day for day in days if day not in first)
            out += [(UR10E, first, (day,)) for day in rest]
            out += [(UR10E, first, rest)]
    for arm, runs in _RUNS.items():
        logs = [_whole(run, length) for run, length in runs.items()]
        out += [(arm, (a,), (b,)) for a, b in permutations(logs, 2)]
        out += [(arm, tuple(x for x in logs if x != b), (b,)) for b in logs]
    third = _UR10 / 3
    parts = [Part("run.csv", 0, i * third, third) for i in range(3)]
    out += [(UR10, (a,), (b,)) for a, b in permutations(parts, 2)]
    short = [_whole(run, length) for run, length in _GEN3.items()]
    return out + [(GEN3, (a,), (b,)) for a, b in permutations(short, 2)]


def load_epochs() -> list[tuple[tuple[Part, ...], tuple[Part, ...]]]:
    before = [_whole(day, _DAYS[day]) for day in ("feb19", "feb12")]
    after = (Part(_LOADED, 0, 0.0, _LOADED_LENGTH),)
    return [((before[0],), after), ((before[1], before[0]), after)]


def drawn_epochs(arm: str, rng: Rng) -> tuple[tuple[Part, ...], tuple[Part, ...]]:
    """Draw the epochs of a change: of the UR10e 20 to 50 s of other days in each."""
    if arm == UR10E:
        days = [str(day) for day in rng.permutation(list(_DAYS))]
        many = int(rng.integers(2, 4))
        return (
            _windows(days[:many], rng),
            _windows(days[many : many + int(rng.integers(1, 3))], rng),
        )
    if arm == UR10:
        half = _UR10 / 2
        parts = [Part("run.csv", 0, i * half, half) for i in rng.permutation(2)]
        return (parts[0],), (parts[1],)
    runs = [str(run) for run in rng.permutation(list(_RUNS[arm]))]
    logs = [_whole(run, _RUNS[arm][run]) for run in runs]
    return tuple(logs[:2]), (logs[2],)


def _windows(days: Sequence[str], rng: Rng) -> tuple[Part, ...]:
    """Return a window of each day, all of them as long as an epoch is."""
    whole = sum(_DAYS[day] for day in days)
    total = rng.uniform(_EPOCH[0], min(_EPOCH[1], whole))
    out = []
    for day in days:
        length = round(_DAYS[day] * total / whole, 1)
        start = round(float(rng.uniform(0.0, _DAYS[day] - length)), 1)
        out.append(Part(f"{day}.csv", 0, start, length))
    return tuple(out)


def read(case: Case, parts: Sequence[Part]) -> tuple[Recording, ...]:
    return tuple(_read(case.arm, part) for part in parts)


def drawn(case: Case, name: str, rng: Rng, target: float) -> Planted | None:
    """Draw a change of that size, None where the arm cannot have it."""
    body = plain_body(case.arm)
    dof = body.robot.dof
    joints = () if name in added.WHOLE else (int(rng.integers(1, dof + 1)),)
    values = _usual(name, joints, body, rng)
    states = [added.state(log, body) for log in read(case, case.second)]

    def size_at(factor: float) -> float | None:
        many = _times(name, values, factor)
        if not _possible(name, many, joints, body):
            return None
        pairs = [(added.changed(at, name, joints, many), at.log) for at in states]
        return size_of([shares(body.rigid, *pair) for pair in pairs], joints)

    found = solved(size_at, target)
    if found is None:
        return None
    many = tuple(sorted(_times(name, values, found[0]).items()))
    # As a verdict has it: a load is on the last joint.
    return Planted(name, (dof,) if name == "payload" else joints, many, found[1])


def planted_logs(case: Case) -> tuple[Recording, ...]:
    logs = read(case, case.second)
    for one in case.planted:
        body, change = (
            plain_body(case.arm),
            (one.name, one.joints, dict(one.parameters)),
        )
        logs = tuple(added.changed(added.state(log, body), *change) for log in logs)
    return logs


def _usual(name: str, joints: Sequence[int], body: Body, rng: Rng) -> dict[str, float]:
    j = joints[0] - 1 if joints else 0
    torque, way = float(body.torque[j]), float(rng.choice([-1.0, 1.0]))
    turn = float(rng.uniform(0, 2 * np.pi))
    weight = sum(link.mass for link in list(body.robot.model.inertias)[1:])
    centre = 0.06 * reach(body.robot.model) * rng.normal(size=3)
    one: Mapping[str, dict[str, float]] = {
        "offset": {"torque": 0.1 * way * torque},
        "coulomb": {"level": 0.1 * way * torque},
        "viscous": {"coefficient": 0.1 * way * torque},
        "spring": {"stiffness": 0.1 * torque, "rest": float(rng.uniform(-1, 1))},
        "load_friction": {"coefficient": 0.05},
        "torque_gain": {"gain": 0.1 * way},
        "ripple": {"amplitude": 0.1 * torque, "phase": turn}
        | {"order": float(rng.uniform(6.0, 30.0))},
        "stribeck": {"level": 0.1 * torque, "velocity": float(rng.uniform(0.05, 0.2))},
        "coulomb_asymmetry": {"level": 0.1 * way * torque},
        "quadratic_viscous": {"coefficient": 0.1 * torque},
        "elasticity": {"stiffness": torque / 0.005},
        "backlash": {"half_gap": 0.002},
        "encoder_offset": {"angle": 0.03 * way},
        "encoder_eccentricity": _polar(0.02, turn, "cos", "sin"),
        "base_tilt": _polar(0.05, turn, "tilt_x", "tilt_y"),
        "delay": {"delay": 0.01},
        "payload": {"mass": 0.03 * weight}
        | dict(zip(("com_x", "com_y", "com_z"), map(float, centre), strict=True)),
    }
    return one[name]


def _polar(size: float, angle: float, *keys: str) -> dict[str, float]:
    return {keys[0]: size * float(np.cos(angle)), keys[1]: size * float(np.sin(angle))}


_FIXED = ("rest", "order", "phase", "velocity", "com_x", "com_y", "com_z")


def _times(name: str, values: Values, factor: float) -> dict[str, float]:
    """Return the parameters of the same change with so many times the torque."""
    power = -1.0 if name == "elasticity" else 1.0
    return {k: v if k in _FIXED else v * factor**power for k, v in values.items()}


def _possible(name: str, values: Values, joints: Sequence[int], body: Body) -> bool:
    j = joints[0] - 1 if joints else 0
    torque = float(body.torque[j])
    free = [v for k, v in values.items() if k not in _FIXED]
    size = free[0] if len(free) == 1 else float(np.linalg.norm(free))
    if name in _OF_OWN:
        what, least, most = _OF_OWN[name]
        own = max(float(getattr(body, what)[j]), _LEAST_OWN * torque)
        return least * own <= size <= most * own
    if name in _OF_RMS:
        return abs(size) <= _OF_RMS[name] * torque
    if name == "elasticity":
        return torque / size <= plant.MOST_TWIST
    if name == "payload":
        links = list(body.robot.model.inertias)[1:]
        return size <= plant.MOST_LOAD * sum(link.mass for link in links)
    return abs(size) <= plant.MOST[name]


@lru_cache(maxsize=64)
def _read(arm: str, part: Part) -> Recording:
    end = f"{part.start + part.duration:.6f}".rstrip("0").rstrip(".")
    return read_logs(arm, [f"{part.what}@{part.start:.6f}:{end}"])[0]


@lru_cache(maxsize=4)
def plain_body(arm: str) -> Body:
    """Return what plain least squares make of all logs of an arm, the loaded apart."""
    robot = robot_of(arm)
    dof, model = robot.dof, robot.model
    columns, torque, moves = [], [], []
    files = sorted(file.name for file in folder_of(arm).glob("*.csv"))
    for log in read_logs(arm, [name for name in files if name != _LOADED]):
        at = smooth(log)
        rows = slice(None, None, max(1, round(0.02 / (at.t[1] - at.t[0]))))
        own = (np.tanh(at.qd / 0.02), at.qd, at.qdd, np.ones_like(at.q))
        local = [each[rows, :, None] * np.eye(dof) for each in own]
        inertial = regressor(model, at.q[rows], at.qd[rows], at.qdd[rows])
        columns.append(np.concatenate([inertial, *local], axis=2))
        torque.append(at.tau[rows])
        moves.append(moving(at)[rows])
    x, tau, kept = (np.concatenate(each) for each in (columns, torque, moves))
    rms = np.sqrt((tau**2).mean(axis=0))
    known = np.concatenate([inertial_parameters(model), np.zeros(4 * dof)])
    left = ((tau - x @ known) / rms)[kept]
    x = (x / rms[:, None])[kept]
    size = np.linalg.norm(x, axis=0) + 1e-9
    scaled = x / size
    gram = scaled.T @ scaled + _RIDGE * np.eye(len(size))
    found = known + np.linalg.solve(gram, scaled.T @ left) / size
    dry, viscous = np.split(found[10 * dof :], 4)[:2]
    return Body(robot, found[: 10 * dof], dry, viscous, rms)
