"""Group 3: steps per second against a bare PyBullet loop in the same run."""

from time import process_time

import numpy as np
import pinocchio as pin

from benchmarks.figures import Figures, figure
from benchmarks.plant_parts.runs import ROBOT, drawn, drive, reference
from sim.engine.bullet import World
from sim.experiment import run_experiment
from sim.plant.controller import KD, KP
from sim.records import PlantSpec, Rates, Reference

# The full plant: friction of every kind, rotors, a payload and a ripple.
_FULL = ("payload", "stribeck", "load_friction", "ripple", "coulomb_asymmetry")


def speed_figures(rounds: int) -> Figures:
    """Time both loops in turn, one after the other, and one whole experiment.

    The bare loop is computed torque by Pinocchio's RNEA on PyBullet's own arm, with
    no rotor, friction, noise, faults or record but position.
    """
    motion, effects = reference("fourier", 5.0), drawn(_FULL, 1)
    drive(effects, motion, 1)
    _bare(motion)
    ratios, rates = [], []
    for _ in range(rounds):
        bare, full = (_cpu(job) for job in _jobs(effects, motion))
        ratios.append(bare / full)
        rates.append(len(motion.t) / full)
    long = reference("fourier", 20.0)
    plant = PlantSpec(effects, seed=1)
    whole = _cpu(lambda: run_experiment(ROBOT, long, plant, Rates()))
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


def _jobs(effects: tuple, motion: Reference) -> tuple:
    return (lambda: _bare(motion), lambda: drive(effects, motion, 1))


def _cpu(job: object) -> float:
    """Return the processor time of a call: other processes do not count [s]."""
    start = process_time()
    job()
    return process_time() - start


def _bare(motion: Reference) -> np.ndarray:
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
