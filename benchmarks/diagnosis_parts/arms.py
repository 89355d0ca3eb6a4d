"""Logs of arms that hide something: synthetic ones for the bulk, PyBullet for a part.

Motions go by one seed, the arm and its noise by another, so that several arms may be
looked at in one excitation, whose minimum detectable sizes are known.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from benchmarks.synthetic.motions import make_motion
from flows.blind.row import true_parameters
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot
from sim.catalogue import forms, kinds
from sim.plant.sensors import encoder, torque_noise
from sim.quasi_static import Plant, true_friction, true_torque
from sim.records import (
    Hidden,
    Noise,
    PlantEffect,
    PlantSpec,
    Rates,
    TrajectorySpec,
    stream,
)
from sim.sizes import room, sizes

SYNTHETIC, PYBULLET = "synthetic", "pybullet"
RATE, PAUSE = 250.0, 10.0  # Hz, s


@dataclass(frozen=True, slots=True)
class Plan:
    """Which logs a case has.

    Attributes:
        fit: Motion families to diagnose.
        held_out: Motion families for the proof.
        duration: Length of each log [s].
    """

    fit: tuple[str, ...]
    held_out: tuple[str, ...]
    duration: float = 20.0


PLANS = {
    SYNTHETIC: Plan(
        ("fourier", "fourier", "cyclic", "slow_cyclic", *2 * ("move_stop_move",)),
        ("fourier", "move_stop_move", "cyclic"),
    ),
    PYBULLET: Plan(
        ("fourier", "fourier", "cyclic", "cyclic", "move_stop_move"),
        ("welding", "fourier"),
    ),
    "quick": Plan(("fourier", "cyclic", "move_stop_move"), ("fourier",), 12.0),
}


@dataclass(frozen=True, eq=False, slots=True)
class Made:
    """One case with the truth beside it.

    Attributes:
        robot: The arm as the diagnosis may know it.
        fit: Logs to diagnose.
        held_out: Logs for the proof.
        truths: True parameters of each hidden effect, as a verdict states them.
    """

    robot: Robot
    fit: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    truths: tuple[dict, ...]


@lru_cache(maxsize=1)
def the_arm() -> Robot:
    """Return the built-in arm with the friction that its file declares."""
    return load_robot("irb140")


def make(data: str, effects: Sequence[PlantEffect], motion: int, arm: int) -> Made:
    """Record one case.

    Args:
        data: "synthetic", "pybullet" or "quick" (synthetic, short).
        effects: What the arm hides; forms of other authors only on synthetic ones.
    """
    plan = PLANS[data]
    record = _pybullet if data == PYBULLET else _synthetic
    logs, truths = record(plan, tuple(effects), motion, arm)
    count = len(plan.fit)
    return Made(the_arm(), tuple(logs[:count]), tuple(logs[count:]), tuple(truths))


def _synthetic(plan: Plan, effects: tuple[PlantEffect, ...], motion: int, arm: int):
    robot = the_arm()
    hidden = tuple(Hidden(e.name, e.joints, dict(e.parameters)) for e in effects)
    plant = Plant(robot, hidden, arm)
    logs = []
    for place, family in enumerate((*plan.fit, *plan.held_out)):
        name = f"{'fit' if place < len(plan.fit) else 'held_out'}_{place}_{family}"
        rng = stream(motion, f"motion/{name}")
        made = make_motion(family, room(robot), plan.duration, RATE, rng)
        start = place * (plan.duration + PAUSE)
        torque = true_torque(plant, made, name, start)
        noise = torque_noise(
            len(made.t), sizes(robot).torque, RATE, stream(arm, f"torque/{name}")
        )
        q = encoder(torque.reading, stream(arm, f"encoder/{name}"))
        t = start + made.t
        logs.append(
            Recording(id=name, robot=robot.name, t=t, q=q, tau=torque.tau + noise)
        )
    return logs, [_with_scatter(plant, e) for e in effects]


def _with_scatter(plant: Plant, effect: PlantEffect) -> dict:
    """Return what a verdict would state: a change is against what the maker says."""
    values, known = dict(effect.parameters), kinds().get(effect.name)
    if known is not None and known.of_drive:
        key, field = known.amount[0], known.of_drive
        joint = effect.joints[0] - 1
        true, told = true_friction(plant), sizes(plant.robot)
        values[key] += float(getattr(true, field)[joint] - getattr(told, field)[joint])
    return values


def _pybullet(plan: Plan, effects: tuple[PlantEffect, ...], motion: int, arm: int):
    # Late: the engine is a slow import.
    from sim.experiment import run_experiment

    robot, rates = the_arm(), Rates(1000.0, RATE)
    plant = PlantSpec(effects, noise=Noise(), seed=arm)
    logs = []
    for place, family in enumerate((*plan.fit, *plan.held_out)):
        seed = 100 * motion + place
        reference = _reference(TrajectorySpec(family, plan.duration, 2, seed))
        start = place * (plan.duration + PAUSE)
        logs.append(run_experiment(robot, reference, plant, rates, start).log)
    return logs, true_parameters(robot, plant)


@lru_cache(maxsize=16)
def _reference(spec: TrajectorySpec):
    from sim.trajectories import make_reference

    return make_reference(the_arm(), spec, 1000.0)


def as_form(effect: PlantEffect, form: str) -> PlantEffect:
    """Return an effect as another author writes it down."""
    values = dict(effect.parameters)
    if form == "lugre":
        values["displacement"] = 2e-3  # rad: the bristles of a heavy gear
    assert effect.name in forms()[form]
    return PlantEffect(form, effect.joints, tuple(sorted(values.items())))
