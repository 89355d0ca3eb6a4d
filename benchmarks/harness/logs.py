"""Logs for several benchmarks: of synthetic arms, of the physics engine, as CSV."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from residual.recording import Recording
from residual.robot.robot import Robot
from sim.engine.plant_records import PlantSpec, SampleRates, TrajectorySpec
from sim.engine.plant_records import ReferenceMotion as Motion
from sim.engine.plant_records import create_random_stream as make_rng
from sim.experiment import run_experiment
from sim.plant.sensors import ENCODER_STEP, draw_torque_noise, simulate_encoder
from sim.plant.typical_sizes import estimate_typical_sizes
from sim.trajectories import plan_reference_motion
from tests.synthetic.motions import make_motion
from tests.synthetic.quasi_static import Plant, Torque, true_torque

Array = np.ndarray
RATE, CONTROL, PAUSE = 250.0, 1000.0, 10.0  # Hz, Hz, s between two logs


@dataclass(frozen=True, eq=False, slots=True)
class Logs:
    """One case: an arm as its diagnosis may know it, and its logs."""

    robot: Robot
    fit: tuple[Recording, ...]  # logs to diagnose
    held_out: tuple[Recording, ...]  # logs for the proof
    # True parameters of each hidden effect, as a verdict states them
    truths: tuple[dict, ...] = ()


def list_motions(
    robot: Robot, fit: Sequence[str], held_out: Sequence[str], duration: float, seed: int
) -> list[tuple[str, Motion, float]]:
    """Return name, motion and start [s] of each log of a case, by its motion families."""
    out = []
    for place, family in enumerate((*fit, *held_out)):
        name = f"{'fit' if place < len(fit) else 'held_out'}_{place}_{family}"
        rng = make_rng(seed, f"motion/{name}")
        motion = make_motion(family, robot, duration, RATE, rng)
        out.append((name, motion, place * (duration + PAUSE)))
    return out


def sensed(
    robot: Robot,
    torque: Torque,
    label: str,
    seed: int,
    rate: float = RATE,
    span: Array | None = None,
    step: float = ENCODER_STEP,
) -> tuple[Array, Array]:
    """Return angles and torques as the sensors of a synthetic arm read them.

    Name of the log and seed make the noise; that of a torque goes by the range of its
    joint [N m], which is the usual one or given. Encoders have a step [rad].
    """
    rng = make_rng(seed, f"torque/{label}")
    span = estimate_typical_sizes(robot).torque if span is None else span
    tau = torque.tau + draw_torque_noise(len(torque.tau), span, rate, rng)
    rng = make_rng(seed, f"encoder/{label}")
    return simulate_encoder(torque.reading, rng, step), tau


def record(plant: Plant, motion: Motion, label: str, seed: int, start: float, **sensors: object):
    """Return the log of a motion of a synthetic arm, which starts at a time [s]."""
    torque = true_torque(plant, motion, label, start)
    signals = sensed(plant.robot, torque, label, seed, **sensors)
    return Recording(label, plant.robot.name, start + motion.t, *signals)


def in_engine(
    robot: Robot, plant: PlantSpec, spec: TrajectorySpec, start: float, name: str | None = None
) -> Recording:
    rates = SampleRates(CONTROL, RATE)
    made = run_experiment(robot, reference(robot, spec), plant, rates, start)
    return made.log if name is None else replace(made.log, id=name)


@lru_cache(maxsize=32)
def reference(robot: Robot, spec: TrajectorySpec) -> Motion:
    return plan_reference_motion(robot, spec, CONTROL)
