"""Is the plant exact, sound in its books, stable, the same again, fast, well excited?

Speed is that of steps against a bare PyBullet loop in the same run. The optimised
Fourier motion is held against the best of 20 random motions of the same period: random
coefficients at rest at both ends, about a random posture, each joint as large as its
range, speed and acceleration let it, and then the whole so small as torque and
clearance ask for.
"""

import time

import numpy as np
import pinocchio as pin

from benchmarks.harness.figures import Figures, figure
from benchmarks.harness.rates import cpu
from benchmarks.synthetic.motions import make_motion
from residual.robot.robot import load_robot
from sim.draw import draw_hidden
from sim.engine import records
from sim.engine.bullet import World
from sim.experiment import run_experiment
from sim.plant.arm import build_arm
from sim.plant.controller import KD, KP, computed_torque
from sim.plant.sizes import usual_limits
from sim.plant.stepping import Trace, simulate
from sim.trajectories import make_reference
from sim.trajectories.excitation import excitation
from sim.trajectories.fourier import draw, sampled
from sim.trajectories.limits import workspace

ROBOT = load_robot("irb140")
Effects = tuple[records.PlantEffect, ...]


def drawn(names: tuple[str, ...], seed: int) -> Effects:
    return tuple(
        draw_hidden(ROBOT, records.stream(seed, f"hidden/{n}"), n) for n in names
    )


def reference(
    family: str, duration: float, seed: int = 1, rate: float = 1000.0
) -> records.Reference:
    space, rng = usual_limits(ROBOT), records.stream(seed, f"motion/{family}")
    return make_motion(family, space, duration, rate, rng)


def drive(effects: Effects, motion: records.Reference, seed: int) -> Trace:
    arm = build_arm(ROBOT, records.PlantSpec(effects, seed=seed))
    controller = computed_torque(ROBOT, motion)
    return simulate(arm, motion, controller, "benchmark", 0.0, seed)


# The full plant: friction of every kind, rotors, a payload and a ripple.
_FULL = ("payload", "stribeck", "load_friction", "ripple", "coulomb_asymmetry")


def speed_figures(quick: bool) -> Figures:
    """Time both loops in turn, one after the other, and one whole experiment.

    The bare loop is computed torque by Pinocchio's RNEA on PyBullet's own arm, with
    no rotor, friction, noise, faults or record but position.
    """
    rounds = 3 if quick else 11
    motion, effects = reference("fourier", 5.0), drawn(_FULL, 1)
    drive(effects, motion, 1)
    _bare(motion)
    ratios, rates = [], []
    for _ in range(rounds):
        bare, full = cpu(lambda: _bare(motion)), cpu(lambda: drive(effects, motion, 1))
        ratios.append(bare / full)
        rates.append(len(motion.t) / full)
    long = reference("fourier", 20.0)
    plant = records.PlantSpec(effects, seed=1)
    whole = cpu(lambda: run_experiment(ROBOT, long, plant, records.Rates()))
    # figure() wants small values: what must not be exceeded is bare over full rate.
    ratio = float(np.median(ratios))
    return {
        "step_rate_of_bare": figure(
            ratio,
            0.35,
            rounds,
            ok=ratio >= 0.35,
            at_least=True,
            range=[min(ratios), max(ratios)],
            steps_per_second=round(float(np.median(rates))),
        ),
        "experiment_cpu_seconds": figure(whole, None, 1, what="20 s and its twin"),
    }


def _bare(motion: records.Reference) -> np.ndarray:
    model, data = ROBOT.model, ROBOT.model.createData()
    path = np.empty_like(motion.q)
    with World(model, 1e-3) as world:
        q, qd = motion.q[0], motion.qd[0]
        world.reset(q, qd)
        for k in range(len(motion.t)):
            path[k] = q
            demand = motion.qdd[k] + KP * (motion.q[k] - q) + KD * (motion.qd[k] - qd)
            world.step(pin.rnea(model, data, q, qd, demand))
            q, qd = world.state()
    return path


_RANDOM = 20
_RATE = 250.0  # Hz
_CONDITION, _SECONDS = 0.5, 30.0  # bars


def excitation_figures(quick: bool) -> Figures:
    """Compare optimised and random motions of the built-in arm, of ten seeds or two."""
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
    reference = make_reference(ROBOT, records.TrajectorySpec(seed=seed), _RATE)
    once = reference.t <= reference.period
    motion = (reference.q[once], reference.qd[once], reference.qdd[once])
    return excitation(ROBOT.model, *motion).condition


def _best_random(seed: int) -> float:
    spec = records.TrajectorySpec()
    place = workspace(ROBOT, spec.duration / spec.periods)
    t = np.arange(0, place.period, 1 / _RATE)
    rng = records.stream(seed, "benchmark/random motions")
    drawn = [sampled(draw(place, rng), t) for _ in range(_RANDOM)]
    return min(excitation(ROBOT.model, *motion).condition for motion in drawn)
