"""Is the optimised Fourier motion worth its search?

Against the best of 20 random motions of the same period: random coefficients at rest at
both ends, about a random posture, each joint as large as its range, speed and
acceleration let it, and then the whole so small as torque and clearance ask for.
"""

import time

import numpy as np

from benchmarks.figures import Figures, figure
from residual.robot.robot import load_robot
from sim.records import TrajectorySpec, stream
from sim.trajectories import make_reference
from sim.trajectories.excitation import excitation
from sim.trajectories.fourier import arena, draw, sampled

_RANDOM = 20
_RATE = 250.0  # Hz
_CONDITION, _SECONDS = 0.5, 30.0  # bars


def excitation_figures(quick: bool) -> Figures:
    """Compare optimised and random motions of the built-in arm.

    Args:
        quick: Two seeds instead of ten.
    """
    ratios, seconds = [], []
    for seed in range(2 if quick else 10):
        started = time.perf_counter()
        best = _optimised(seed)
        seconds.append(time.perf_counter() - started)
        ratios.append(best / _best_random(seed))
    return {
        "excitation_condition_vs_random": figure(
            max(ratios), _CONDITION, len(ratios), each=[round(r, 3) for r in ratios]
        ),
        "excitation_seconds": figure(max(seconds), _SECONDS, len(seconds)),
    }


def _optimised(seed: int) -> float:
    robot = load_robot("irb140")
    reference = make_reference(robot, TrajectorySpec(seed=seed), _RATE)
    once = reference.t <= reference.period
    return excitation(
        robot.model, reference.q[once], reference.qd[once], reference.qdd[once]
    ).condition


def _best_random(seed: int) -> float:
    robot, spec = load_robot("irb140"), TrajectorySpec()
    place = arena(robot, spec.duration / spec.periods)
    t = np.arange(0, place.period, 1 / _RATE)
    rng = stream(seed, "benchmark/random motions")
    drawn = [sampled(draw(place, rng), t) for _ in range(_RANDOM)]
    return min(excitation(robot.model, *motion).condition for motion in drawn)
