"""Recordings of a synthetic arm, and whole cases to diagnose."""

from dataclasses import dataclass

import numpy as np

from benchmarks.harness.logs import RATE, sensed
from residual.recording import Recording
from residual.robot.robot import Robot
from sim.engine.plant_records import SyntheticEffect
from sim.engine.plant_records import create_random_stream as make_rng
from sim.plant.effect_catalogue import list_drive_effects
from sim.plant.plant_arm import simulate_torque_logging
from tests.synthetic.motions import make_motion
from tests.synthetic.quasi_static import Plant, background_of, true_torque

DURATION = 20.0  # s
_PAUSE = (5.0, 20.0)  # s between two logs of a session
_BETWEEN_SESSIONS = 3600.0  # s between baseline and fit logs

# Declared by default with unknown level: only a change against a baseline shows.
CHANGES = tuple(effect.name for effect in list_drive_effects())


@dataclass(frozen=True, slots=True)
class LogPlan:
    """One log to record."""

    name: str
    part: str  # "baseline" (without hidden effects), "fit" or "held_out"
    family: str
    duration: float = DURATION  # length [s]
    rate: float = RATE  # samples per second [Hz]


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """Logs with the truth beside them."""

    robot: Robot  # the robot as the diagnosis may know it
    fit: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    # Logs before the effect came; empty without a baseline
    baseline: tuple[Recording, ...]
    truth: SyntheticEffect | None  # the first hidden effect, None in a null case


def make(plant: Plant, plan: tuple[LogPlan, ...], seed: int) -> list[Recording]:
    """Record the logs of a plan, one after the other.

    Time runs on through pauses from log to log. The session of the hidden effects
    (warm-up) begins with the first log that is not baseline. Motions, pauses and noise
    have their own streams of the seed.
    """
    recordings, clock, session = [], 0.0, None
    for entry in plan:
        if entry.part != "baseline" and session is None:
            clock += _BETWEEN_SESSIONS if recordings else 0.0
            session = clock
        recordings.append(_record(plant, entry, seed, (clock, session)))
        pause = make_rng(seed, f"pause/{entry.name}").uniform(*_PAUSE)
        clock = round(clock + entry.duration + pause, 3)
    return recordings


def make_case(plant: Plant, plan: tuple[LogPlan, ...]) -> Case:
    """Record a plan and return its logs by part; the seed is that of the arm."""
    logs: dict[str, list[Recording]] = {"fit": [], "held_out": [], "baseline": []}
    for entry, log in zip(plan, make(plant, plan, plant.seed), strict=True):
        logs[entry.part].append(log)
    truth = plant.hidden[0] if plant.hidden else None
    return Case(plant.robot, *map(tuple, logs.values()), truth)


def _record(
    plant: Plant, entry: LogPlan, seed: int, clock: tuple[float, float | None]
) -> Recording:
    now, session = clock
    motion = make_motion(
        entry.family,
        plant.robot,
        entry.duration,
        entry.rate,
        make_rng(seed, f"motion/{entry.name}"),
    )
    active = session is not None
    start = now - session if active else 0.0
    worked = start if active else now
    torque = true_torque(plant, motion, entry.name, start, active, worked)
    q, tau = sensed(plant.robot, torque, entry.name, seed, entry.rate)
    tau = simulate_torque_logging(background_of(plant), tau, entry.rate)
    return Recording(entry.name, plant.robot.name, now + motion.t, q, tau)


def write_csv(path, log, form="%.17g", delimiter=",", **more) -> None:
    """Write times, angles, torques and further signals, all in one form or one for each."""
    signals = {"q": log.q, "tau": log.tau, **more}
    joints = range(1, 1 + log.q.shape[1])
    names = ["t", *(f"{name}{j}" for name in signals for j in joints)]
    table = np.column_stack([log.t, *signals.values()])
    np.savetxt(path, table, form, delimiter, header=delimiter.join(names), comments="")
