"""Sound logs of simulated and measured arms, and helpers for faults in them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from benchmarks.harness.logs import PAUSE, RATE, in_engine, record
from benchmarks.harness.origin import ROOT
from benchmarks.measured_parts.arms import absent, read_logs, robot_of
from residual.recording import Recording as Log
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import Robot, build_robot, load_robot
from sim.engine.plant_records import (
    PlantSpec,
    ReferenceMotion,
    SensorNoise,
    TrajectorySpec,
    create_random_stream,
)
from tests.synthetic.motions import make_motion
from tests.synthetic.quasi_static import Plant
from warehouse.logs import read_log

Array = np.ndarray

SIX, SEVEN, ENGINE, HIDDEN = "six", "seven", "engine", "hidden"
MEASURED = ("kr300", "ur10", "lwr4", "gen3")
DRAWN = (SIX, SEVEN, ENGINE)
HOSTS = (*DRAWN, HIDDEN, *MEASURED)
FAMILIES = ("fourier", "cyclic", "move_stop_move")
DURATION = 12.0  # s
SPEED_NOISE = 0.005  # rad/s, of the speeds that the six-joint arm logs
_FILES = {
    HIDDEN: [f"{n}.csv@0:12" for n in ("fit_1", "fit_2", "fit_3")],
    "kr300": ["run_A.csv", "run_B.csv", "run_C.csv"],
    "ur10": ["run.csv"],
    "lwr4": ["run_1.csv@0:12", "run_2.csv@0:12"],
    "gen3": ["fourier_1.csv", "fourier_2.csv"],
}


@dataclass(frozen=True, eq=False, slots=True)
class Host:
    """An arm and its clean logs."""

    name: str  # one of HOSTS
    robot: Robot  # the arm as its file describes it
    logs: tuple[Log, ...]  # clean logs, SI, at the link side
    # The arm itself where it is synthetic, for motions of one's own
    plant: Plant | None = None


@lru_cache(maxsize=4)
def host(name: str, seed: int) -> Host | None:
    """Return an arm with its logs, None where measured ones are absent."""
    if name == ENGINE:
        return Host(name, load_robot("irb140"), _in_engine(seed))
    if name in DRAWN:
        return synthetic(name, seed)
    return _measured(name)


def synthetic(name: str, seed: int) -> Host:
    robot = load_robot("irb140") if name == SIX else seven()
    plant = Plant(robot, (), seed)
    logs = []
    for i, family in enumerate(FAMILIES):
        rng = create_random_stream(seed, f"motion/{name}/{family}")
        motion = make_motion(family, robot, DURATION, RATE, rng)
        start = i * (DURATION + PAUSE)
        logs.append(recorded(plant, motion, f"{name}_{family}", start))
    return Host(name, robot, tuple(logs), plant)


def recorded(plant: Plant, motion: ReferenceMotion, label: str, start: float) -> Log:
    """Return the log of a motion, by the sensors of all synthetic arms."""
    rng = create_random_stream(plant.seed, f"speed/{label}")
    speed = motion.qd + SPEED_NOISE * rng.normal(size=motion.qd.shape)
    log = record(plant, motion, label, plant.seed, start)
    return replace(log, qd=speed) if plant.robot.dof == 6 else log


def _in_engine(seed: int) -> tuple[Log, ...]:
    """Return two logs of the built-in arm in the physics engine, under control."""
    robot, plant = load_robot("irb140"), PlantSpec((), noise=SensorNoise(), seed=seed)
    logs = []
    for i, family in enumerate(FAMILIES[:2]):
        spec = TrajectorySpec(family, DURATION, 2, 100 * seed + i)
        start = i * (DURATION + PAUSE)
        logs.append(in_engine(robot, plant, spec, start, f"engine_{family}"))
    return tuple(logs)


def _measured(name: str) -> Host | None:
    if name == HIDDEN:
        robot, folder = load_robot("irb140"), ROOT / "examples/hidden"
        logs = [read_log(f"{folder / f}", robot)[0] for f in _FILES[name]]
    elif absent(name):
        return None
    else:
        robot, logs = robot_of(name), read_logs(name, _FILES[name])
    logs = [replace(log, id=log.id.split("@")[0]) for log in logs]
    return Host(name, robot, tuple(logs))


_LINK = """<link name="l{i}"><inertial><origin xyz="{c}"/><mass value="{m}"/>
<inertia ixx="{a}" iyy="{b}" izz="{a}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j{i}" type="revolute"><parent link="l{p}"/><child link="l{i}"/>
<origin xyz="{o}"/><axis xyz="{x}"/>
<limit lower="-2.8" upper="2.8" velocity="2.5" effort="{e}"/></joint>"""
_Y, _Z = "0 1 0", "0 0 1"


def chain(name: str, axes: str, length: float, mass: float, effort: float = 300.0) -> Robot:
    """Return an arm of links along z, each lighter than the one before.

    Args:
        axes: Axis of each joint at zero, "y" or "z", joint 1 first.
        length: Of the first link [m], as mass [kg] and effort [N m] are.
    """
    parts = [f'<robot name="{name}"><link name="l0"/>']
    for i, axis in enumerate(axes):
        shrink = 0.8**i
        long, heavy = length * shrink, mass * shrink
        across = heavy * long**2 / 12
        parts.append(
            _LINK.format(
                i=i + 1,
                p=i,
                c=f"{0.08 * long} {0.1 * long} {0.5 * long}",
                m=heavy,
                a=across,
                b=1.2 * across,
                o=f"0 0 {length * 0.8 ** (i - 1) if i else 0.3}",
                x=_Y if axis == "y" else _Z,
                e=effort * shrink,
            )
        )
    return build_robot(name, "".join([*parts, "</robot>"]), "{}")


@lru_cache(maxsize=1)
def seven() -> Robot:
    """Return an arm of seven joints, of the build of the light arms of today."""
    return chain("seven", "zyzyzyz", 0.32, 5.0)


def other_arms(dof: int) -> tuple[Robot, ...]:
    axes = {6: ("yzyzyz", "zyzyyz", "yyzyzy"), 7: ("yzyzyzy", "zzyyzyy", "yyzzyzy")}
    dimensions = ((0.4, 12.0), (0.25, 6.0), (0.6, 25.0))
    return tuple(
        chain(f"other-{i}", axis, *size)
        for i, (axis, size) in enumerate(zip(axes[dof], dimensions, strict=True))
    )


Table = dict[str, Array]
SIGNALS = ("t", "q", "qd", "tau")
_DIFFERENCE = 0.1  # of a joint's torque: two readings that differ by less are one


@dataclass(frozen=True, eq=False, slots=True)
class FaultyLogs:
    """Logs with one fault, and the truth beside them."""

    kind: str  # what was done to them
    joints: tuple[int, ...]  # where, from 1; () for all
    tables: Sequence[Table]  # signals of each log by name
    # The same as a right repair reads them; empty where none can
    right: Sequence[Table] = ()
    urdf: str = ""  # text of the robot file that is given
    toml: str = ""  # text of the robot.toml that is given, "" for none
    also: tuple[str, ...] = ()  # other kinds that are as right
    may: tuple[int, ...] = ()  # joints that may be named, too
    beside: "FaultyLogs | None" = None  # another fault of the same logs


Fault = Callable[[Host, int, np.random.Generator], "FaultyLogs | None"]


def table_of(log: Log) -> Table:
    return {k: v for k in SIGNALS if (v := getattr(log, k)) is not None}


def tables_of(host: Host) -> list[Table]:
    return [table_of(log) for log in host.logs]


def changed(tables: Sequence[Table], names: Sequence[str], change: Callable) -> list:
    """Return tables with a change of those of some signals that they have."""
    return [t | {k: change(t[k]) for k in names if k in t} for t in tables]


def some(rng: np.random.Generator, dof: int, count: int) -> tuple[int, ...]:
    return tuple(sorted(int(j) + 1 for j in rng.choice(dof, count, replace=False)))


def turned(dof: int, joints: Sequence[int]) -> Array:
    """Return factors of -1 at some joints, else 1."""
    return np.array([-1.0 if j + 1 in joints else 1.0 for j in range(dof)])


def differ(host: Host, angles: Callable, torques: Callable, logged: float = 0.0) -> bool:
    """Whether two readings of a log differ by what the nominal model says of them.

    An arm is the mirror image of itself where the angles of some joints, and their
    torques, are turned: nobody can tell one reading from the other there. They have to
    differ by a share of the logged torque, friction and all, on some joint too.
    """
    log = host.logs[0]
    step = max(1, len(log.t) // 1000)
    q, t = log.q[::step], log.t[::step]
    own = _model_torque(host, t, q)
    read = _model_torque(host, t, angles(q))
    size = np.sqrt(np.mean(own**2, axis=0)) + 1e-9
    apart = np.sqrt(np.mean((torques(own) - read) ** 2, axis=0))
    seen = apart / (np.std(torques(log.tau[::step]), axis=0) + 1e-9)
    return bool((apart / size).max() > _DIFFERENCE and seen.max() > logged)


def _model_torque(host: Host, t: Array, q: Array) -> Array:
    qd = np.gradient(q, t, axis=0)
    return compute_inverse_dynamics(host.robot.model, q, qd, np.gradient(qd, t, axis=0))
