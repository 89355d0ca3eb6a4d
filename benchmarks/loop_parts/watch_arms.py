"""Arms with undeclared friction that run on, and what is changed of them."""

from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError
from residual.recording import Recording
from residual.robot.robot import load_robot
from sim.background.torque import logged
from sim.draw import draw_hidden
from sim.plant.arm import build_arm
from sim.plant.controller import ComputedTorque
from sim.plant.stepping import simulate
from sim.records import (
    WORKSHOP,
    PlantEffect,
    PlantSpec,
    Rates,
    Reference,
    TrajectorySpec,
)
from sim.sensors import log_of
from sim.streams import motion_label, stream
from sim.trajectories import make_reference

ROBOT = load_robot("irb140")
UNDECLARED = (
    "stribeck",
    "coulomb_asymmetry",
    "quadratic_viscous",
    "viscous_asymmetry",
)
_CYCLE = 5.0  # s at least: welding in less often breaks a limit of the arm
_LOAD = 1.0  # kg
_DROP = -0.3


@dataclass(frozen=True, slots=True)
class Run:
    """One run of an arm.

    Attributes:
        arm: Seed of the arm.
        family: Kind of motion.
        number: Makes the motion.
        seconds: Length [s].
        start: Time since the session of the arm began [s].
        change: "", "load" or "gain".
        joint: Joint of a changed gain, from 1.
    """

    arm: int
    family: str
    number: int
    seconds: float
    start: float
    change: str = ""
    joint: int = 0


def log_run(run: Run) -> Recording:
    """Return the log of a run; its twin is not needed."""
    motion = _motion(run)
    plant = PlantSpec(_effects(run), seed=run.arm, background=WORKSHOP)
    arm, label = build_arm(ROBOT, plant), motion_label(motion, run.start)
    control = ComputedTorque(ROBOT, motion)
    trace = simulate(arm, motion, control, label, run.start, run.arm)
    noise, rates = (plant.noise, plant.seed, label, run.start), Rates()
    log = log_of(ROBOT, trace, motion, plant.effects, noise, rates)
    return replace(log, tau=logged(arm.own, log.tau, rates.log))


def _motion(run: Run) -> Reference:
    rng = stream(run.number, f"watch/{run.arm}/{run.family}")
    most = int(run.seconds // _CYCLE)
    while True:  # some draws break a limit of the arm
        periods = int(rng.integers(min(3, most), most + 1))
        seed = int(rng.integers(2**31))
        spec = TrajectorySpec(run.family, run.seconds, periods, seed)
        try:
            return make_reference(ROBOT, spec, Rates().control, optimised=False)
        except InputError:
            continue


def _effects(run: Run) -> tuple[PlantEffect, ...]:
    rng = stream(run.arm, "watch/undeclared")
    names = rng.choice(UNDECLARED, 2, replace=False)
    out = [draw_hidden(ROBOT, rng, str(name)) for name in names]
    if run.change == "load":
        way = stream(run.number, f"watch/{run.arm}/load").normal(size=3)
        x, y, z = 0.1 * way / np.linalg.norm(way)
        held = (("mass", _LOAD), ("com_x", x), ("com_y", y), ("com_z", abs(z)))
        out.append(PlantEffect("payload", (ROBOT.dof,), held))
    if run.change == "gain":
        out.append(PlantEffect("torque_gain", (run.joint,), (("gain", _DROP),)))
    return tuple(out)
