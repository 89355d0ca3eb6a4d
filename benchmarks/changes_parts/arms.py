"""Simulated arms in use, recorded over two sessions with or without a change.

One seed makes the arm, with its background; every motion has a seed of its own, and
so has the noise. So the same motion may come again in another session.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pinocchio as pin

from benchmarks.changes_parts.case import Case, Part
from benchmarks.check_parts.arms import others, seven
from benchmarks.harness.logs import CONTROL, PAUSE, RATE, reference, sensed
from benchmarks.synthetic import quasi_static
from benchmarks.synthetic.motions import make_motion
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot
from sim.engine import records
from sim.engine.laws import thinned
from sim.experiment import log_of
from sim.plant import tables as at
from sim.plant.arm import build_arm
from sim.plant.background import Background, logged
from sim.plant.friction import AMBIENT, RISE
from sim.plant.sizes import usual_limits
from sim.plant.stepping import drive

Array = np.ndarray
Effects = Sequence[records.PlantEffect]

ENGINE = "pybullet"
BUILT_IN, SEVEN, OTHER_SEVEN = "irb140", "seven", "seven-0"
SIX = (BUILT_IN, "other-0", "other-1", "other-2")
ARMS = (ENGINE, *SIX, SEVEN, OTHER_SEVEN)
FIRST, SECOND = "first", "second"

_LATER = 86400.0  # s from the first session to the second
_MOVES = 0.05  # rad/s
# The engine names its noise by motion and time: another time is another noise.
_SHIFT = 1e-3  # s


@dataclass(frozen=True, eq=False, slots=True)
class Truly:
    """What an arm truly is, without what changed."""

    model: pin.Model
    drives: records.Drives
    # What all its joints have undeclared, None if it is clean
    background: Background | None
    reported: Array  # reported torque over real torque. Shape (dof,).


@lru_cache(maxsize=8)
def robot_of(arm: str) -> Robot:
    if arm in (ENGINE, BUILT_IN):
        return load_robot("irb140")
    if arm == SEVEN:
        return seven()
    kind, _, number = arm.partition("-")
    return others(7 if kind == SEVEN else 6)[int(number)]


def truly(case: Case) -> Truly:
    """Return what the arm of a case truly is."""
    robot = robot_of(case.arm)
    if case.arm == ENGINE:
        arm = build_arm(robot, _spec(case, (), 0.0, True))
        model, drives, own = arm.model, arm.base, arm.own
    else:
        plant = quasi_static.Plant(robot, (), case.plant, case.background)
        friction, own = (
            quasi_static.true_friction(plant),
            quasi_static.background_of(plant),
        )
        model = quasi_static.true_model(plant)
        drives = records.Drives(friction.coulomb, friction.viscous, friction.rotor)
    gain = np.zeros(robot.dof) if own is None else own.gain
    return Truly(model, drives, own, 1.0 + gain)


def record(
    case: Case, epoch: str, effects: Effects, exact: bool = False
) -> tuple[Recording, ...]:
    """Record all logs of one epoch, of the second with its held-out one."""
    return tuple(log for log, _ in _records(case, epoch, effects, exact))


def warmed(case: Case) -> float | None:
    """Return friction of the second epoch over that of the first, by warmth alone."""
    factors = []
    for epoch in (FIRST, SECOND):
        found = [factor for _, factor in _records(case, epoch, (), True)]
        if any(f is None for f in found):
            return None
        factors.append(np.mean(found, axis=0))
    return float(np.mean(factors[1] / factors[0]))


def _records(
    case: Case, epoch: str, effects: Effects, exact: bool
) -> Iterator[tuple[Recording, Array | None]]:
    """Yield every log, with friction over cold friction where it moves, by joint."""
    one = _in_engine if case.arm == ENGINE else _synthetic
    first = epoch == FIRST
    parts = case.first if first else (*case.second, *case.held_out)
    start, later = 0.0, 0.0 if first else _LATER
    for place, part in enumerate(parts):
        label = f"{epoch}_{place}_{part.what}"
        log, factor = one(case, part, effects, label, start, exact)
        yield replace(log, id=label, t=later + log.t), factor
        start += part.duration + PAUSE


def _synthetic(
    case: Case, part: Part, effects: Effects, label: str, start: float, exact: bool
) -> tuple[Recording, Array | None]:
    robot = robot_of(case.arm)
    hidden = tuple(
        records.Hidden(e.name, e.joints, dict(e.parameters)) for e in effects
    )
    plant = quasi_static.Plant(robot, hidden, case.plant, case.background)
    motion = make_motion(
        part.what,
        usual_limits(robot),
        part.duration,
        RATE,
        records.stream(part.seed, "motion"),
    )
    worked = case.worked[not label.startswith(FIRST)] + start
    torque = quasi_static.true_torque(plant, motion, label, start, True, worked)
    read = sensed(robot, torque, label, case.noise)
    q, tau = (torque.reading, torque.tau) if exact else read
    tau = logged(quasi_static.background_of(plant), tau, RATE)
    log = Recording(label, robot.name, start + motion.t, q, tau)
    if torque.background is None:
        return log, None
    return log, _where_it_moves(torque.background.factor, motion.qd)


def _in_engine(
    case: Case, part: Part, effects: Effects, label: str, start: float, exact: bool
) -> tuple[Recording, Array | None]:
    """As `sim.experiment.run_experiment`, without the twin that nobody asks for."""
    robot, rates = robot_of(case.arm), records.Rates(CONTROL, RATE)
    motion = reference(records.TrajectorySpec(part.what, part.duration, 2, part.seed))
    later = not label.startswith(FIRST)
    start += _SHIFT * (case.noise % 1000) + later
    spec = _spec(case, effects, case.worked[later], exact)
    trace = drive(robot, motion, spec, start)
    log, own = log_of(trace, motion, spec, rates, start), trace.arm.own
    if own is None:
        return log, None
    every = round(CONTROL / RATE)
    warm = (trace.rows[::every, at.TEMPERATURE] - AMBIENT) / RISE
    speed = trace.rows[::every, at.QD]
    return log, _where_it_moves(thinned(warm, own.growth), speed)


def _spec(
    case: Case, effects: Effects, worked: float, exact: bool
) -> records.PlantSpec:
    return records.PlantSpec(
        tuple(effects),
        noise=records.Noise(0.0, 0.0) if exact else records.Noise(),
        seed=case.plant,
        background=case.background,
        worked_before=worked,
    )


def _where_it_moves(factor: Array, qd: Array) -> Array:
    """Return the mean of a factor by joint, where friction shows. Shape (dof,)."""
    weight = (np.abs(qd) > _MOVES) + 1e-9
    return (factor * weight).sum(axis=0) / weight.sum(axis=0)
