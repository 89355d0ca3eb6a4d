"""Short runs of the plant, shared by its tests."""

import numpy as np

from benchmarks.synthetic.motions import make_motion
from residual.robot.robot import load_robot
from sim.engine.records import PlantEffect, PlantSpec, Reference, stream
from sim.plant.arm import build_arm
from sim.plant.sizes import usual_limits
from sim.plant.stepping import computed_torque, simulate

ROBOT = load_robot("irb140")


def effect(name, joints=(), onset=0.0, **parameters):
    joints = (joints,) if isinstance(joints, int) else tuple(joints)
    return PlantEffect(name, joints, tuple(parameters.items()), onset)


def motion(family="fourier", duration=3.0, seed=1, rate=1000.0):
    return make_motion(
        family, usual_limits(ROBOT), duration, rate, stream(seed, "motion")
    )


def standing(duration, q=None, rate=1000.0):
    t = np.arange(round(duration * rate)) / rate
    still = np.zeros((len(t), ROBOT.dof))
    return Reference(
        "standing", t, still + (0.3 if q is None else q), still, still, None
    )


def drive(*effects, reference=None, controller=None, start=0.0, **spec):
    reference = motion() if reference is None else reference
    plant = PlantSpec(effects, **spec)
    controller = controller or computed_torque(ROBOT, reference)
    arm = build_arm(ROBOT, plant)
    return simulate(arm, reference, controller, "", start, plant.seed)
