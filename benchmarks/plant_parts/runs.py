"""Arms, motions and runs that the groups share."""

import numpy as np
from scipy.ndimage import uniform_filter1d

from benchmarks.synthetic.motions import make_motion
from residual.robot.robot import load_robot
from sim.draw import draw_hidden
from sim.plant import tables as at
from sim.plant.arm import build_arm
from sim.plant.controller import ComputedTorque
from sim.plant.stepping import Trace, simulate
from sim.records import PlantEffect, PlantSpec, Reference, stream
from sim.sizes import room

ROBOT = load_robot("irb140")
Effects = tuple[PlantEffect, ...]


def drawn(names: tuple[str, ...], seed: int) -> Effects:
    """Draw the effects of these names."""
    return tuple(draw_hidden(ROBOT, stream(seed, f"hidden/{n}"), n) for n in names)


def reference(
    family: str, duration: float, seed: int = 1, rate: float = 1000.0
) -> Reference:
    """Return a motion."""
    space, rng = room(ROBOT), stream(seed, f"motion/{family}")
    m = make_motion(family, space, duration, rate, rng)
    return Reference(family, m.t, m.q, m.qd, m.qdd, None)


def drive(effects: Effects, motion: Reference, seed: int) -> Trace:
    """Drive the arm of a seed along a motion."""
    arm = build_arm(ROBOT, PlantSpec(effects, seed=seed))
    controller = ComputedTorque(ROBOT, motion)
    return simulate(arm, motion, controller, "benchmark", 0.0, seed)


def hum(trace: Trace, motion: Reference) -> float:
    """Return what oscillates above 20 Hz in the speeds of motors 1 to 3 [rad/s]."""
    second = round(1.0 / (motion.t[1] - motion.t[0]))
    miss = (trace.rows[:, at.READING_RATE] - motion.qd)[second:, :3]
    slow = uniform_filter1d(miss, second // 20, axis=0)
    return float(np.std(miss - slow, axis=0).max())
