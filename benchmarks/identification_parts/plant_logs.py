"""Logs of the plant, whose truth is known, for the groups of the benchmark."""

from functools import cache

import numpy as np

from benchmarks.synthetic.motions import make_motion
from residual.model.model import Model
from residual.recording import Recording
from residual.robot.dynamics import inertial_parameters
from residual.robot.robot import load_robot
from sim.experiment import run_experiment
from sim.plant.arm import build_arm
from sim.records import Noise, PlantSpec, Rates, Reference, stream
from sim.sizes import room

ROBOT = load_robot("irb140")
FIT, HELD_OUT = ("fourier", "cyclic", "fourier"), ("slow_cyclic",)
_DURATION, _SCATTER = 15.0, 0.1


@cache
def plant_logs(seed: int, noise: float = 0.015) -> tuple[list, list]:
    """Drive the plant of a seed along motions: logs to fit, and another family.

    Args:
        noise: Torque noise, as a share of each joint's usual range.
    """
    logs = [_log(f, k, seed, noise) for k, f in enumerate((*FIT, *HELD_OUT))]
    return logs[: len(FIT)], logs[len(FIT) :]


def true_coefficients(model: Model, seed: int) -> np.ndarray:
    """What the coefficients of a model are on the plant of a seed."""
    arm = build_arm(ROBOT, _plant(seed, 0.015))
    of = {
        "viscous": arm.base.viscous,
        "coulomb": arm.base.coulomb,
        "rotor_inertia": arm.base.rotor,
    }
    effects = [of[t.effect.name][t.joints[0]] for t in model.terms]
    return np.concatenate([inertial_parameters(arm.model), effects])


def _plant(seed: int, noise: float) -> PlantSpec:
    return PlantSpec((), _SCATTER, Noise(torque=noise), seed)


def _log(family: str, number: int, seed: int, noise: float) -> Recording:
    rng = stream(1000 * seed + number, f"motion/{family}")
    m = make_motion(family, room(ROBOT), _DURATION, 1000.0, rng)
    motion = Reference(family, m.t, m.q, m.qd, m.qdd, None)
    start = 2 * _DURATION * number
    log = run_experiment(ROBOT, motion, _plant(seed, noise), Rates(), start).log
    return Recording(f"{family}{number}", log.robot, log.t, log.q, log.tau)
