"""Logs of arms in use: a baseline, and new logs with or without a change.

One seed makes the arm, with its background, and the motions; another the noise and
what is hidden. So several changes are looked at on one arm, whose detectable sizes
are known.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from benchmarks.check_parts.arms import others, seven
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot
from sim.background.laws import thinned
from sim.background.torque import logged
from sim.plant.thermal import AMBIENT, RISE
from sim.records import Hidden, Noise, PlantEffect, PlantSpec, Rates, TrajectorySpec
from sim.streams import stream
from sim.synthetic.motion import make_motion
from sim.synthetic.plant import Plant, background_of, true_torque
from sim.synthetic.room import room
from sim.synthetic.sensors import encoder, torque_noise
from sim.synthetic.sizes import sizes

Array = np.ndarray

PYBULLET, SEVEN, OTHER, QUICK = "pybullet", "seven", "other", "quick"
RATE, PAUSE = 250.0, 10.0  # Hz, s
BASELINE, NEW = "baseline", "new"
_LATER = 86400.0  # s from the baseline to the new logs
_WARM = (300.0, 1500.0)  # s of work before a session that begins warm
_MOVES = 0.05  # rad/s


@dataclass(frozen=True, slots=True)
class Arm:
    """One arm in two sessions.

    Attributes:
        data: "pybullet", "seven", "other" or "quick".
        background: How dirty it is.
        seed: Seed of the arm and of the motions.
        noise: Seed of the noise.
        moved: Whether one session begins cold and the other warm, for sure.
    """

    data: str
    background: str
    seed: int
    noise: int
    moved: bool = False

    @property
    def robot(self) -> Robot:
        """Its description."""
        return robot_of(self.data, self.seed)

    @property
    def worked(self) -> dict[str, float]:
        """Usual work of the arm before each session [s]."""
        rng = stream(self.seed, "sessions")
        warm, first = rng.uniform(*_WARM, 2), bool(rng.integers(2))
        second = not first if self.moved else bool(rng.integers(2))
        return {BASELINE: float(warm[0]) * first, NEW: float(warm[1]) * second}


@dataclass(frozen=True, slots=True)
class Plan:
    """Motion families of a case, and how long each log is [s]."""

    baseline: tuple[str, ...]
    fit: tuple[str, ...]
    held_out: tuple[str, ...]
    duration: float = 20.0


_THREE = ("fourier", "cyclic", "move_stop_move")
AGAINST = Plan(_THREE, _THREE, ("fourier",))
ALONE = Plan((), (*_THREE, "fourier", "cyclic", "move_stop_move"), ("fourier",) * 2)


@dataclass(frozen=True, eq=False, slots=True)
class Made:
    """One case with the truth beside it.

    Attributes:
        robot: The arm as the diagnosis may know it.
        baseline: Logs of before; empty without one.
        fit: Logs to diagnose.
        held_out: Logs for the proof.
        factor: Friction in the new logs over that of the baseline, by temperature
            alone, over all joints; None for a clean arm or without a baseline.
    """

    robot: Robot
    baseline: tuple[Recording, ...]
    fit: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    factor: float | None


@lru_cache(maxsize=1)
def the_arm() -> Robot:
    """Return the built-in arm with the friction that its file declares."""
    return load_robot("irb140")


def robot_of(data: str, seed: int) -> Robot:
    """Return the robot of a kind of case."""
    if data == SEVEN:
        return seven()
    if data == OTHER:
        builds = (the_arm(), *others(6))
        return builds[seed % len(builds)]
    return the_arm()


def make(arm: Arm, effects: Sequence[PlantEffect], plan: Plan) -> Made:
    """Record one case.

    Args:
        arm: The arm.
        effects: What is new since the baseline; without one, what it has.
        plan: Which logs.
    """
    record = _pybullet if arm.data == PYBULLET else _synthetic
    if arm.data == QUICK:
        plan = replace(plan, duration=12.0)
    logs, factors = {BASELINE: [], NEW: []}, {BASELINE: [], NEW: []}
    families = {BASELINE: plan.baseline, NEW: (*plan.fit, *plan.held_out)}
    for part, kinds in families.items():
        hidden = tuple(effects) if part == NEW else ()
        for place, family in enumerate(kinds):
            log, factor = record(arm, hidden, (part, place, family), plan.duration)
            later = _LATER if part == NEW and plan.baseline else 0.0
            logs[part].append(replace(log, t=later + log.t))
            factors[part].append(factor)
    new, count = tuple(logs[NEW]), len(plan.fit)
    factor = _ratio(factors[NEW], factors[BASELINE])
    return Made(arm.robot, tuple(logs[BASELINE]), new[:count], new[count:], factor)


def _ratio(new: Sequence, before: Sequence) -> float | None:
    if not before or any(f is None for f in (*new, *before)):
        return None
    return float(np.mean(np.mean(new, axis=0) / np.mean(before, axis=0)))


def _synthetic(arm: Arm, effects, which: tuple[str, int, str], duration: float):
    part, place, family = which
    robot, name = arm.robot, f"{part}_{place}_{family}"
    hidden = tuple(Hidden(e.name, e.joints, dict(e.parameters)) for e in effects)
    plant = Plant(robot, hidden, arm.seed, arm.background)
    rng = stream(arm.seed, f"motion/{name}")
    motion = make_motion(family, room(robot), duration, RATE, rng)
    start = place * (duration + PAUSE)
    worked = arm.worked[part] + start
    torque = true_torque(plant, motion, name, start, True, worked)
    rng = stream(arm.noise, f"torque/{name}")
    tau = torque.tau + torque_noise(len(motion.t), sizes(robot).torque, RATE, rng)
    q = encoder(torque.reading, stream(arm.noise, f"encoder/{name}"))
    tau = logged(background_of(plant), tau, RATE)
    log = Recording(name, robot.name, start + motion.t, q, tau)
    if torque.background is None:
        return log, None
    return log, _where_it_moves(torque.background.factor, motion.qd)


def _pybullet(arm: Arm, effects, which: tuple[str, int, str], duration: float):
    # Late: the engine is a slow import.
    from sim.experiment import run_experiment

    part, place, family = which
    plant = PlantSpec(
        tuple(effects),
        noise=Noise(),
        seed=arm.seed,
        background=arm.background,
        worked_before=arm.worked[part],
    )
    seed = 100 * arm.seed + 10 * (part == NEW) + place
    reference = _reference(TrajectorySpec(family, duration, 2, seed))
    # Noise goes by the time of a motion as well: a millisecond makes it another.
    start = place * (duration + PAUSE) + 1e-3 * (arm.noise % 1000)
    run = run_experiment(the_arm(), reference, plant, Rates(1000.0, RATE), start)
    log = replace(run.log, id=f"{part}_{place}_{family}")
    growth = run.truth.get("background_growth")
    if growth is None:
        return log, None
    warm = (run.truth["temperature"] - AMBIENT) / RISE
    return log, _where_it_moves(thinned(warm, growth), run.truth["qd"])


@lru_cache(maxsize=16)
def _reference(spec: TrajectorySpec):
    from sim.trajectories import make_reference

    return make_reference(the_arm(), spec, 1000.0)


def _where_it_moves(factor: Array, qd: Array) -> Array:
    """Return the mean of a factor by joint, where friction shows. Shape (dof,)."""
    weight = (np.abs(qd) > _MOVES) + 1e-9
    return (factor * weight).sum(axis=0) / weight.sum(axis=0)
