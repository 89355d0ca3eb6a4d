"""Simulated arms in use, recorded in two sessions with or without a change.

One seed makes the arm and its background; every motion and the noise have seeds of
their own, so that a motion can be repeated in another session.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from benchmarks.check_parts.arms import other_arms, seven
from benchmarks.harness.logs import PAUSE, RATE, sensed
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot
from sim.engine.plant_records import PlantEffect, ReferenceMotion, create_random_stream
from sim.plant.plant_arm import simulate_torque_logging
from tests.synthetic import quasi_static
from tests.synthetic.motions import make_motion

Array = np.ndarray

SIX = ("irb140", "other-0", "other-1", "other-2")
SEVEN = ("seven", "seven-0")
FIRST, SECOND = "first", "second"
_LATER = 86400.0  # s from the first session to the second
_MOVES = 0.05  # rad/s


@dataclass(frozen=True, slots=True)
class Part:
    """One log of an epoch."""

    source: str  # motion family, or file of a measured log
    seed: int = 0  # of the motion
    start: float = 0.0  # in a measured file [s]
    duration: float = 0.0  # [s]


@dataclass(frozen=True, slots=True)
class Case:
    """One arm in two epochs."""

    arm: str
    background: str = ""  # undeclared effects of all joints; "" of a measured arm
    plant: int = 0  # seed of what makes this arm differ from its description
    noise: int = 0  # seed
    worked: tuple[float, float] = (0.0, 0.0)  # usual work before each session [s]
    first: tuple[Part, ...] = ()
    second: tuple[Part, ...] = ()
    held_out: tuple[Part, ...] = ()  # of the second epoch; empty of a measured arm
    effect: PlantEffect | None = None  # what changes
    size: float = 0.0  # RMS of its torque over RMS of the joint's torque


@lru_cache(maxsize=8)
def robot_of(arm: str) -> Robot:
    if arm == "irb140":
        return load_robot(arm)
    if arm == "seven":
        return seven()
    kind, _, number = arm.partition("-")
    return other_arms(7 if kind == "seven" else 6)[int(number)]


def reported(case: Case) -> Array:
    """Return reported torque over real torque of each joint. Shape (dof,)."""
    background = quasi_static.background_of(_plant(case))
    return 1.0 + (0.0 if background is None else background.gain) * np.ones(robot_of(case.arm).dof)


def list_motions(robot: Robot, parts: Sequence[Part]) -> list[tuple[ReferenceMotion, float]]:
    """Return the motion and start [s] of each log of an epoch."""
    out, start = [], 0.0
    for part in parts:
        rng = create_random_stream(part.seed, "motion")
        motion = make_motion(part.source, robot, part.duration, RATE, rng)
        out.append((motion, start))
        start += part.duration + PAUSE
    return out


def record(case: Case, epoch: str, exact: bool = False) -> tuple[Recording, ...]:
    """Record all logs of one epoch; exact logs have no noise."""
    return tuple(log for log, _ in _records(case, epoch, exact))


def warmed(case: Case) -> float:
    """Return friction of the second epoch over that of the first, by warmth alone."""
    first, second = (
        np.mean([factor for _, factor in _records(case, epoch, True)], axis=0)
        for epoch in (FIRST, SECOND)
    )
    return float(np.mean(second / first))


def _plant(case: Case, changed: bool = False) -> quasi_static.Plant:
    hidden = (case.effect,) if changed and case.effect else ()
    return quasi_static.Plant(robot_of(case.arm), hidden, case.plant, case.background)


def _records(case: Case, epoch: str, exact: bool) -> Iterator[tuple[Recording, Array | None]]:
    """Yield every log, with friction over cold friction where it moves, by joint."""
    second = epoch == SECOND
    plant, robot = _plant(case, second), robot_of(case.arm)
    background = quasi_static.background_of(plant)
    parts = (*case.second, *case.held_out) if second else case.first
    for place, (motion, start) in enumerate(list_motions(robot, parts)):
        label = f"{epoch}_{place}_{parts[place].source}"
        worked = case.worked[second] + start
        torque = quasi_static.true_torque(plant, motion, label, start, True, worked)
        q, tau = torque.reading, torque.tau
        if not exact:
            q, tau = sensed(robot, torque, label, case.noise)
        tau = simulate_torque_logging(background, tau, RATE)
        t = _LATER * second + start + motion.t
        factor = None
        if torque.background is not None:
            weight = (np.abs(motion.qd) > _MOVES) + 1e-9
            factor = (torque.background.factor * weight).sum(axis=0)
            factor = factor / weight.sum(axis=0)
        yield Recording(label, robot.name, t, q, tau), factor
