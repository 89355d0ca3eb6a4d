"""Clean logs of arms: two synthetic, one in a physics engine, and measured ones."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from benchmarks.figures import ROOT
from benchmarks.measured_parts.arms import data_folder
from benchmarks.synthetic.motions import make_motion
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot, robot_from_texts
from sim.plant.sensors import encoder, torque_noise
from sim.quasi_static import Plant, true_torque
from sim.records import Noise, PlantSpec, Rates, Reference, TrajectorySpec, stream
from sim.sizes import room, sizes
from warehouse.logs import load_columns, read_log

Array = np.ndarray

SIX, SEVEN, ENGINE, HIDDEN = "six", "seven", "engine", "hidden"
MEASURED = ("kr300", "ur10", "lwr4", "gen3")
DRAWN = (SIX, SEVEN, ENGINE)
HOSTS = (*DRAWN, HIDDEN, *MEASURED)
FAMILIES = ("fourier", "cyclic", "move_stop_move")
DURATION, RATE, PAUSE = 12.0, 250.0, 10.0
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
    """An arm and its clean logs.

    Attributes:
        name: One of HOSTS.
        robot: The arm as its file describes it.
        logs: Clean logs, SI, at the link side.
        plant: The arm itself where it is synthetic, for motions of one's own.
    """

    name: str
    robot: Robot
    logs: tuple[Recording, ...]
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
    """Return a synthetic arm with one log of each family."""
    robot = load_robot("irb140") if name == SIX else seven()
    plant = Plant(robot, (), seed)
    logs = []
    for i, family in enumerate(FAMILIES):
        rng = stream(seed, f"motion/{name}/{family}")
        motion = make_motion(family, room(robot), DURATION, RATE, rng)
        start = i * (DURATION + PAUSE)
        logs.append(recorded(plant, motion, f"{name}_{family}", start))
    return Host(name, robot, tuple(logs), plant)


def recorded(plant: Plant, motion: Reference, label: str, start: float) -> Recording:
    """Return the log of a motion, by the sensors of all synthetic arms."""
    robot, seed = plant.robot, plant.seed
    torque = true_torque(plant, motion, label, start)
    rng = stream(seed, f"speed/{label}")
    speed = motion.qd + SPEED_NOISE * rng.normal(size=motion.qd.shape)
    span, noise = sizes(robot).torque, stream(seed, f"torque/{label}")
    return Recording(
        id=label,
        robot=robot.name,
        t=start + motion.t,
        q=encoder(torque.reading, stream(seed, f"encoder/{label}")),
        tau=torque.tau + torque_noise(len(motion.t), span, RATE, noise),
        qd=speed if robot.dof == 6 else None,
    )


def _in_engine(seed: int) -> tuple[Recording, ...]:
    """Return two logs of the built-in arm in the physics engine, under control."""
    # Late: the engine is a slow import.
    from sim.experiment import run_experiment
    from sim.trajectories import make_reference

    robot, rates = load_robot("irb140"), Rates(1000.0, RATE)
    plant, logs = PlantSpec((), noise=Noise(), seed=seed), []
    for i, family in enumerate(FAMILIES[:2]):
        spec = TrajectorySpec(family, DURATION, 2, 100 * seed + i)
        reference = make_reference(robot, spec, 1000.0)
        start = i * (DURATION + PAUSE)
        log = run_experiment(robot, reference, plant, rates, start).log
        logs.append(replace(log, id=f"engine_{family}"))
    return tuple(logs)


def _measured(name: str) -> Host | None:
    if name == HIDDEN:
        folder, robot, columns = ROOT / "examples/hidden", load_robot("irb140"), None
    else:
        data = data_folder()
        if data is None or not (data / name).is_dir():
            return None
        folder = data / name
        robot = load_robot(folder / f"{name}.urdf")
        columns = load_columns(folder / "current.toml") if name == "gen3" else None
    logs = [read_log(str(Path(folder) / f), robot, columns)[0] for f in _FILES[name]]
    logs = [replace(log, id=log.id.split("@")[0]) for log in logs]
    return Host(name, robot, tuple(logs))


_LINK = """<link name="l{i}"><inertial><origin xyz="{c}"/><mass value="{m}"/>
<inertia ixx="{a}" iyy="{b}" izz="{a}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j{i}" type="revolute"><parent link="l{p}"/><child link="l{i}"/>
<origin xyz="{o}"/><axis xyz="{x}"/>
<limit lower="-2.8" upper="2.8" velocity="2.5" effort="{e}"/></joint>"""
_Y, _Z = "0 1 0", "0 0 1"


def chain(
    name: str, axes: str, length: float, mass: float, effort: float = 300.0
) -> Robot:
    """Return an arm of links along z, each lighter than the one before.

    Args:
        name: What it is called.
        axes: Axis of each joint at zero, "y" or "z", joint 1 first.
        length: Of the first link [m].
        mass: Of the first link [kg].
        effort: Limit of the first joint [N m].
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
    return robot_from_texts(name, "".join([*parts, "</robot>"]), "{}")


@lru_cache(maxsize=1)
def seven() -> Robot:
    """Return an arm of seven joints, of the build of the light arms of today."""
    return chain("seven", "zyzyzyz", 0.32, 5.0)


def others(dof: int) -> tuple[Robot, ...]:
    """Return arms of other builds with that many joints."""
    axes = {6: ("yzyzyz", "zyzyyz", "yyzyzy"), 7: ("yzyzyzy", "zzyyzyy", "yyzzyzy")}
    dimensions = ((0.4, 12.0), (0.25, 6.0), (0.6, 25.0))
    return tuple(
        chain(f"other-{i}", axis, *size)
        for i, (axis, size) in enumerate(zip(axes[dof], dimensions, strict=True))
    )
