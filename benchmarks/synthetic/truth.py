"""The model of a simulated arm with its true parameters: what a diagnosis can reach."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from residual.effects import registry
from residual.model.model import Model, Term
from residual.robot.dynamics import inertial_parameters
from residual.robot.robot import Robot
from sim.engine.records import PlantEffect, PlantSpec
from sim.plant.arm import build_arm
from sim.plant.catalogue import acting, changed, kinds

Drives = Mapping[tuple[str, int], float]  # true values by name and joint from 1


def with_truth(
    like: Model, body: pin.Model, drives: Drives, effects: Sequence[PlantEffect]
) -> Model:
    """Return a model with the true parameters of an arm.

    Args:
        like: A model of the arm, for its signals and its declared effects.
        body: The true rigid body, loads and changed links included.
        drives: True friction and rotors, changes included.
        effects: Effects of the arm. Those of bodies and drives are in the other
            arguments; those without a name no model can have.
    """
    terms = [
        replace(t, theta=np.array([drives[t.effect.name, t.joints[0] + 1]]))
        for t in like.terms
        if t.nominal is not None and (t.effect.name, t.joints[0] + 1) in drives
    ]
    for effect in effects:
        kind = kinds()[effect.name]
        if not kind.named or kind.body is not None or kind.of_drive:
            continue
        named = registry()[effect.name]
        values = {**kind.defaults, **dict(effect.parameters)}
        numbers = np.array([float(values[key]) for key in named.parameters])
        theta, shape = named.from_values(numbers, like.robot)
        joints = tuple(j - 1 for j in effect.joints)
        terms.append(Term(named, joints, tuple(shape), np.asarray(theta, dtype=float)))
    inertial = inertial_parameters(body)
    return replace(like, inertial=inertial, terms=tuple(terms), tables=())


def truth_of(robot: Robot, plant: PlantSpec, like: Model) -> Model:
    """Return the true model of an arm in the engine, with the signals of `like`."""
    arm = build_arm(robot, plant)
    drives = {
        (name, j + 1): float(getattr(arm.base, str(kind.of_drive))[j])
        for name, kind in kinds().items()
        if kind.of_drive
        for j in range(robot.dof)
    }
    for effect in plant.effects:
        kind = kinds()[effect.name]
        for joint in effect.joints if kind.of_drive else ():
            drives[effect.name, joint] += dict(effect.parameters)[kind.amount[0]]
    body = changed(arm.model, acting(plant.effects))
    return with_truth(like, body, drives, plant.effects)
