"""Identify arms of the simulation whose parameters are 10 % off the robot file."""

import numpy as np

from benchmarks.harness.figures import Figures, figure
from residual.identification.estimate import Options
from residual.identification.identify import Identification, find_consistent_parameters, identify
from residual.model.compare import compute_model_errors, prepare_held_out
from residual.model.model import Model
from residual.recording import Recording
from residual.robot.dynamics import read_inertial_parameters
from residual.robot.robot import load_robot
from residual.signals.track import build_tracks
from sim.engine.plant_records import PlantSpec, SampleRates, SensorNoise
from sim.engine.plant_records import create_random_stream as make_rng
from sim.experiment import run_experiment
from sim.plant.plant_arm import build_plant_arm
from tests.synthetic.motions import make_motion

Array = np.ndarray

ROBOT = load_robot("irb140")
FIT, HELD_OUT = ("fourier", "cyclic", "fourier"), ("slow_cyclic",)
_DURATION, _SCATTER = 15.0, 0.1


def plant_logs(seed: int) -> tuple[list, list]:
    """Drive the plant of a seed along motions: logs to fit, and another family."""
    logs = [_log(f, k, seed) for k, f in enumerate((*FIT, *HELD_OUT))]
    return logs[: len(FIT)], logs[len(FIT) :]


def true_coefficients(model: Model, seed: int) -> np.ndarray:
    arm = build_plant_arm(ROBOT, _plant(seed))
    of = {"viscous": arm.base.viscous, "coulomb": arm.base.coulomb, "rotor_inertia": arm.base.rotor}
    effects = [of[t.effect.name][t.joints[0]] for t in model.terms]
    return np.concatenate([read_inertial_parameters(arm.model), effects])


def _plant(seed: int) -> PlantSpec:
    return PlantSpec((), _SCATTER, SensorNoise(torque=0.015), seed)


def _log(family: str, number: int, seed: int) -> Recording:
    rng = make_rng(1000 * seed + number, f"motion/{family}")
    motion = make_motion(family, ROBOT, _DURATION, 1000.0, rng)
    start = 2 * _DURATION * number
    log = run_experiment(ROBOT, motion, _plant(seed), SampleRates(), start).log
    return Recording(f"{family}{number}", log.robot, log.t, log.q, log.tau)


def recovery_figures(quick: bool) -> Figures:
    """Identify arms whose parameters are 10 % off, and compare with what they are."""
    seeds = 2 if quick else 20
    rows = [_identified(seed) for seed in range(1, seeds + 1)]
    of = {key: [row[key] for row in rows] for key in rows[0]}
    median = {key: float(np.median(values)) for key, values in of.items()}
    ratio = [c / f for c, f in zip(of["consistent"], of["free"], strict=True)]
    median["ratio"] = float(np.median(ratio))
    more = {
        # Of noise-free torque on an unseen family: what noise cannot blur.
        "recovered_torque_over_nominal": ("recovered", {"all": of["recovered"]}),
        "error_in_standard_deviations": ("z", {"about": 1.0, "all": of["z"]}),
        "friction_error_percent": ("friction", {}),
        "condition": ("condition", {}),
        "held_out_percent": ("free", {"nominal": median["nominal"]}),
        "irls_held_out_percent": ("irls", {}),
        "consistent_over_free": ("ratio", {"worst": float(max(ratio))}),
    }
    least = figure(min(of["least"]), None, seeds, poses=10_000, unit="kg m^2")
    figures = {name: figure(median[key], None, seeds, **x) for name, (key, x) in more.items()}
    return figures | {
        "least_mass_matrix": least | {"bar": 0.0, "ok": least["value"] > 0, "at_least": True}
    }


def _identified(seed: int) -> dict[str, float]:
    fit, held_out = plant_logs(seed)
    result = identify(ROBOT, fit)
    robust = identify(ROBOT, fit, options=Options("irls"))
    bodies = find_consistent_parameters(result)
    truth = true_coefficients(result.nominal, seed)
    theta = result.base.mapping @ truth
    fitted = result.estimate.sd > 0
    z = (result.estimate.theta - theta)[fitted] / result.estimate.sd[fitted]
    size = len(result.nominal.inertial)
    friction = [
        i for i, c in enumerate(result.base.columns) if c >= size and c < size + 2 * ROBOT.dof
    ]
    share = result.estimate.theta[friction] / theta[friction] - 1
    models = {"nominal": result.nominal, "free": result.model}
    models |= {"irls": robust.model, "consistent": bodies.model}
    ready = prepare_held_out(held_out, result.nominal)
    errors, _ = compute_model_errors(models, ready, result.nominal.filters)
    return {
        **{name: errors[name].overall("filtered") for name in models},
        "recovered": _recovered(result, truth, held_out),
        "z": float(np.sqrt(np.mean(z**2))),
        "friction": float(100 * np.sqrt(np.mean(share**2))),
        "condition": result.estimate.condition,
        "least": bodies.least_mass_matrix,
    }


def _recovered(result: Identification, truth: np.ndarray, held_out: list) -> float:
    """Torque by which the model is off the truth, over that of the nominal model."""
    true, misses = result.nominal.with_coefficients(truth), []
    for model in (result.model, result.nominal):
        tracks, _ = build_tracks(held_out, model.filters, model.speed_floor)
        gaps = [model.torque_on(t) - true.torque_on(t) for t in tracks]
        misses.append(float(np.linalg.norm(np.concatenate(gaps))))
    return misses[0] / misses[1]
