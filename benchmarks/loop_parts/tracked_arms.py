"""Arms with one effect that their model lacks: their logs, and what they really are."""

from dataclasses import dataclass

import numpy as np

from residual.close import close_the_loop
from residual.diagnosis.result import Diagnosis
from residual.effects import registry
from residual.model.model import Model
from residual.model.term import Term
from residual.robot.dynamics import inertial_parameters
from residual.robot.robot import Robot
from sim.catalogue import acting, changed
from sim.experiment import draw_hidden, run_experiment
from sim.plant.arm import build_arm
from sim.records import (
    PlantEffect,
    PlantRun,
    PlantSpec,
    Reference,
    TrajectorySpec,
    stream,
)
from sim.trajectories import make_reference

FIT = (*3 * ("fourier",), *3 * ("cyclic",))
HELD_OUT = ("cyclic", "fourier")
UNSEEN = ("welding", "move_stop_move")  # families of which no fit has seen a motion
PAUSE, RATE = 10.0, 1000.0


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """One arm with something to hide, diagnosed.

    Attributes:
        name: The hidden effect.
        robot: Its description.
        plant: What it is.
        runs: Its experiments, those to fit first.
        found: The diagnosis.
    """

    name: str
    robot: Robot
    plant: PlantSpec
    runs: tuple[PlantRun, ...]
    found: Diagnosis

    @property
    def held_out(self) -> list:
        """Logs that no fit has seen."""
        return [run.log for run in self.runs[len(FIT) :]]


def make_case(robot: Robot, name: str, seed: int, seconds: float) -> Case:
    """Draw an effect of a usual size, run experiments, and diagnose them.

    Args:
        seconds: Length of each experiment [s].
    """
    effect = draw_hidden(robot, stream(seed, f"loop/{name}"), name)
    plant = PlantSpec((effect,), seed=seed)
    runs = tuple(
        run_experiment(
            robot,
            motion(robot, kind, 100 * seed + i, seconds),
            plant,
            start=i * (seconds + PAUSE),
        )
        for i, kind in enumerate((*FIT, *HELD_OUT))
    )
    logs = [run.log for run in runs]
    found = close_the_loop(robot, logs[: len(FIT)], held_out=logs[len(FIT) :])
    return Case(name, robot, plant, runs, found)


def motion(robot: Robot, kind: str, seed: int, seconds: float) -> Reference:
    """Return a motion at the rate of the controller."""
    return make_reference(robot, TrajectorySpec(kind, seconds, 1, seed), RATE)


def true_model(case: Case) -> Model:
    """Return the model that knows everything of an arm."""
    robot, arm = case.robot, build_arm(case.robot, case.plant)
    body = inertial_parameters(changed(arm.model, acting(case.plant.effects)))
    drives = (
        ("viscous", arm.base.viscous),
        ("coulomb", arm.base.coulomb),
        ("rotor_inertia", arm.base.rotor),
    )
    terms = [
        _term(robot, name, (joint,), [value])
        for name, values in drives
        for joint, value in enumerate(values)
    ]
    for effect in case.plant.effects:
        terms += _terms_of(robot, effect)
    return Model(robot, body, tuple(terms))


def _terms_of(robot: Robot, hidden: PlantEffect) -> list[Term]:
    effect = registry()[hidden.name]
    if effect.carries == "body":
        return []  # the body has it
    (known,) = acting([hidden])
    values = [float(known.p[key]) for key in effect.parameters]
    places = [(j - 1,) for j in hidden.joints] or [()]
    return [_term(robot, hidden.name, joints, values) for joints in places]


def _term(robot: Robot, name: str, joints: tuple, values: list[float]) -> Term:
    effect = registry()[name]
    theta, shape = effect.from_values(np.array(values), robot)
    return Term(effect, joints, tuple(shape), np.asarray(theta, dtype=float))
