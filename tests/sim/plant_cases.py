"""Short runs of the plant, shared by its tests."""

import numpy as np

from residual.robot.robot import load_robot
from sim.engine.plant_records import PlantEffect, PlantSpec, ReferenceMotion
from sim.engine.plant_records import create_random_stream as make_rng
from sim.plant.closed_loop import choose_controller, simulate_closed_loop
from sim.plant.plant_arm import build_plant_arm
from tests.synthetic.motions import make_motion

ROBOT = load_robot("irb140")


def effect(name, joints=(), onset=0.0, **parameters):
    joints = (joints,) if isinstance(joints, int) else tuple(joints)
    return PlantEffect(name, joints, tuple(parameters.items()), onset)


def motion(family="fourier", duration=3.0, seed=1, rate=1000.0):
    return make_motion(family, ROBOT, duration, rate, make_rng(seed, "motion"))


def standing(duration, q=None, rate=1000.0):
    t = np.arange(round(duration * rate)) / rate
    still = np.zeros((len(t), ROBOT.dof))
    return ReferenceMotion("standing", t, still + (0.3 if q is None else q), still, still, None)


def drive(*effects, reference=None, controller=None, start=0.0, **spec):
    reference = motion() if reference is None else reference
    plant = PlantSpec(effects, **spec)
    controller = controller or choose_controller(ROBOT, reference)
    arm = build_plant_arm(ROBOT, plant)
    return simulate_closed_loop(arm, reference, controller, "", start, plant.seed)
