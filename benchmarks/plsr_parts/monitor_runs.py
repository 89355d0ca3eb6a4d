"""Runs of the plant for the monitor: in good order, or with a sensor that fails."""

from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError
from residual.recording import Recording
from residual.robot.robot import load_robot
from sim.experiment import log_of
from sim.plant.arm import build_arm
from sim.plant.controller import ComputedTorque
from sim.plant.stepping import simulate
from sim.records import (
    PlantEffect,
    PlantSpec,
    Rates,
    Reference,
    TrajectorySpec,
    motion_label,
    stream,
)
from sim.sizes import sizes
from sim.trajectories import make_reference

ROBOT = load_robot("irb140")
_AFTER = 3.5  # s that a run goes on after the onset
_MOVES = 1e-2  # rad: how far a joint is asked to move in the 0.1 s after it froze
_CYCLE = 5.0  # s at least: welding in less often breaks a limit of the arm


@dataclass(frozen=True, slots=True)
class Case:
    """One run: which arm, family and number, and the fault in it, if any."""

    arm: int
    family: str
    number: int
    duration: float
    fault: str = ""


def good_run(case: Case) -> Recording:
    """Make the log of a case."""
    return run_of(case)[2]


def run_of(case: Case) -> tuple[int, float, Recording]:
    """Return the joint with the fault, its onset on the log's clock, and the log."""
    rng = stream(case.number, f"monitoring/{case.arm}/{case.family}/{case.fault}")
    motion, start = _motion(case, rng), float(rng.uniform(0, 600))
    if not case.fault:
        return 0, np.inf, _drive(case.arm, motion, (), start)
    joint, onset = _place(case, motion, rng)
    steps = round((onset + _AFTER) * 1000)
    effect = _effect(case.fault, joint, onset, float(rng.choice([-1.0, 1.0])))
    log = _drive(case.arm, _cut(motion, steps), (effect,), start)
    return joint, start + onset, log


def _motion(case: Case, rng: np.random.Generator) -> Reference:
    most = int(case.duration // _CYCLE)
    periods = int(rng.integers(min(3, most), most + 1))
    while True:  # some draws break a limit of the arm
        spec = TrajectorySpec(
            case.family, case.duration, periods, int(rng.integers(2**31))
        )
        try:
            return make_reference(ROBOT, spec, Rates().control, optimised=False)
        except InputError:
            continue


def _place(case: Case, motion: Reference, rng: np.random.Generator):
    """Draw joint and onset: where the program repeats, and the fault can show."""
    latest = case.duration - 1.5
    first = min(2 * motion.period + 0.5, latest - 1.0)
    while True:
        joint = int(rng.integers(1, ROBOT.dof + 1))
        onset = float(rng.uniform(first, latest))
        k = round(onset * 1000)
        way = np.ptp(motion.q[k : k + 100, joint - 1])
        if case.fault != "frozen" or way > _MOVES:
            return joint, round(onset, 3)


def _effect(fault: str, joint: int, onset: float, sign: float) -> PlantEffect:
    span = sizes(ROBOT).torque[joint - 1]
    name, parameters = {
        "frozen": ("x_fault_frozen", ()),
        "jump": ("encoder_offset", (("angle", sign * np.deg2rad(0.5)),)),
        "spikes": ("x_fault_torque_spikes", (("size", sign * 0.5 * span),)),
        "torque bias": ("x_fault_torque_bias", (("torque", sign * 0.1 * span),)),
        "gain drop": ("torque_gain", (("gain", -0.3),)),
        "gain drop of the log": ("x_fault_torque_gain", (("gain", -0.3),)),
        "drift": ("x_fault_drift", (("rate", sign * np.deg2rad(0.2)),)),
    }[fault]
    return PlantEffect(name, (joint,), parameters, onset)


def _cut(motion: Reference, steps: int) -> Reference:
    arrays = {name: getattr(motion, name)[:steps] for name in ("t", "q", "qd", "qdd")}
    return replace(motion, **arrays)


def _drive(arm: int, motion: Reference, effects: tuple, start: float) -> Recording:
    """Drive an arm and log it; its twin, which takes as long, is not needed."""
    plant, label = PlantSpec(effects, seed=arm), motion_label(motion, start)
    control = ComputedTorque(ROBOT, motion)
    trace = simulate(build_arm(ROBOT, plant), motion, control, label, start, arm)
    noise = (plant.noise, plant.seed, label, start)
    asked = _cut(motion, len(trace.t))
    return log_of(ROBOT, trace, asked, effects, noise, Rates())
