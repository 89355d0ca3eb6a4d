"""Models with one effect each, of two arms: what the tests of exports write."""

from dataclasses import replace
from functools import cache

import numpy as np

from residual.effects import load_effects
from residual.model.model import Model, Term
from residual.robot.dynamics import read_inertial_parameters
from residual.robot.robot import Robot, build_robot, load_robot
from tests.residual.arms import SEVEN, urdf_text

NAMES = sorted(load_effects())
ARMS = ("irb140", "seven")
# Coefficients, and numbers of the shape, that an arm may have: sizes, not units.
SIZES = {
    "backlash": ([1e-3], (1e-3,)),
    "balancer": ([6.0, 4.0], ()),
    "base_tilt": ([0.02, -0.01], ()),
    "coulomb": ([5.0], ()),
    "coulomb_asymmetry": ([1.0], ()),
    "coupled_friction": ([1.0, 0.3, 0.02], (-1.0, 0.05)),
    "delay": ([0.01], (0.012,)),
    "drive_damping": ([1.1], ()),
    "elasticity": ([1e-5], ()),
    "encoder_eccentricity": ([0.01, 0.02], ()),
    "encoder_offset": ([0.02], ()),
    "link_body": ([2.0, 0.2, 0.1, 0.0, 0.05, 0.0, 0.05, 0.0, 0.0, 0.05], ()),
    "link_inertia": ([0.2], ()),
    "load_friction": ([0.05], ()),
    "offset": ([2.0], ()),
    "position_friction": ([1.0, 0.7], ()),
    "power_viscous": ([2.0], (0.5,)),
    "presliding": ([3.0], (0.01,)),
    "quadratic_viscous": ([1.5], ()),
    "ripple": ([0.8, 0.5], (12.0,)),
    "rotor_inertia": ([0.6], ()),
    "saturation": ([1.0], (10.0,)),
    "spring": ([20.0, 3.0], ()),
    "stribeck": ([3.0], (0.1, 1.5)),
    "tool_force": ([5.0, -8.0, 12.0], ()),
    "torque_gain": ([0.05], ()),
    "viscous": ([4.0], ()),
    "viscous_asymmetry": ([0.5], ()),
    "warmup": ([2.0], (30.0,)),
}
BODY = (2.0, 0.02, -0.01, 0.08, 0.01, 0.001, 0.002, 0.012, 0.001, 0.009)


@cache
def robot_of(name: str) -> Robot:
    """The built-in arm, or one of seven joints whose links are bodies that can be."""
    if name != "seven":
        return replace(load_robot("irb140"), declared={})
    text = urdf_text(SEVEN).replace('ixx="0.02"', 'ixx="0.008"')
    return build_robot("seven", text, "{}")


def term(robot: Robot, name: str, place: int | None = None) -> Term:
    """An effect in the middle of the arm, or where it is said."""
    effect = load_effects()[name]
    places = effect.candidates(robot.dof)
    joints = places[len(places) // 2 if place is None else place]
    if name == "payload":
        theta, shape = effect.from_values(np.array(BODY), robot)
    else:
        theta, shape = SIZES[name]
    return Term(effect, joints, tuple(shape), np.array(theta, dtype=float))


def model_with(robot: Robot, *names: str, **changes) -> Model:
    terms = tuple(term(robot, name) for name in names)
    given = {"speed_floor": np.full(robot.dof, 0.01), **changes}
    return Model(robot, read_inertial_parameters(robot.model), terms, **given)
