"""What must be exact, the plant's truth found again, and measured arms.

The books of power judge regressor and inverse dynamics, of which they know nothing:

    tau' qd = d/dt (T(q, qd) + V(q))    (rigid body, no friction)

with the energies of Pinocchio, differentiated numerically along the motion.
"""

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin

from benchmarks.harness.figures import Figures, figure, missing
from benchmarks.measured_parts.arms import SPLITS, data_folder, read_split
from benchmarks.synthetic.motions import make_motion
from residual.identification.estimate import Options
from residual.identification.identify import Identification, identify
from residual.identification.prove import consistent, torque_errors
from residual.model.model import Model
from residual.model.nominal import prepare_logs, start_nominal
from residual.model.record import robot_files
from residual.recording import Recording
from residual.robot import dynamics
from residual.robot.base_parameters import base_parameters
from residual.robot.dynamics import inertial_parameters
from residual.robot.robot import load_robot
from residual.signals.track import prepare
from sim.engine.records import Noise, PlantSpec, Rates, stream
from sim.experiment import run_experiment
from sim.plant.arm import build_arm
from sim.plant.sizes import usual_limits

Array = np.ndarray

_STEP = 2e-4  # s; with the six points used the error falls as its sixth power
_POINTS = (1, 2, 3)
_WEIGHTS = (45 / 60, -9 / 60, 1 / 60)


def energy(model: pin.Model, q: Array, qd: Array) -> Array:
    """Return kinetic plus potential energy [J]. Shape (n,) from (n, dof)."""
    data, out = model.createData(), np.empty(len(q))
    for i in range(len(q)):
        out[i] = pin.computeKineticEnergy(model, data, q[i], qd[i])
        out[i] += pin.computePotentialEnergy(model, data, q[i])
    return out


def power(model: pin.Model, q: Array, qd: Array, qdd: Array) -> Array:
    """Return the rate of energy of states that go on so [W]. Shape (n,) from (n, dof).

    dE/dt by central differences over three points on either side, of sixth order.
    """
    rate = np.zeros(len(q))
    for k, weight in zip(_POINTS, _WEIGHTS, strict=True):
        for side in (-1, 1):
            t = side * k * _STEP
            place, speed = q + t * qd + t**2 / 2 * qdd, qd + t * qdd
            rate += side * weight * energy(model, place, speed)
    return rate / _STEP


def power_miss(
    model: pin.Model, motion: tuple[Array, Array, Array], tau: Array
) -> float:
    """Return |tau' qd - dE/dt| / |tau' qd| over all states, of a torque from elsewhere.

    The motion is q, qd and qdd, each of shape (n, dof).
    """
    given = np.sum(tau * motion[1], axis=1)
    gained = power(model, *motion)
    return float(np.linalg.norm(given - gained) / np.linalg.norm(given))


ROBOT = load_robot("irb140")
FIT, HELD_OUT = ("fourier", "cyclic", "fourier"), ("slow_cyclic",)
_DURATION, _SCATTER = 15.0, 0.1


@cache
def plant_logs(seed: int, noise: float = 0.015) -> tuple[list, list]:
    """Drive the plant of a seed along motions: logs to fit, and another family."""
    logs = [_log(f, k, seed, noise) for k, f in enumerate((*FIT, *HELD_OUT))]
    return logs[: len(FIT)], logs[len(FIT) :]


def true_coefficients(model: Model, seed: int) -> np.ndarray:
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
    motion = make_motion(family, usual_limits(ROBOT), _DURATION, 1000.0, rng)
    start = 2 * _DURATION * number
    log = run_experiment(ROBOT, motion, _plant(seed, noise), Rates(), start).log
    return Recording(f"{family}{number}", log.robot, log.t, log.q, log.tau)


STATES = 1000


def identity_figures(quick: bool) -> Figures:
    """Measure identities on random states, and a model that is written and reloaded."""
    motion = tuple(np.random.default_rng(1).uniform(-2, 2, (3, STATES, ROBOT.dof)))
    base = base_parameters(ROBOT.model)
    theta = base.mapping @ dynamics.inertial_parameters(ROBOT.model)
    rows = dynamics.regressor(ROBOT.model, *motion)[:, :, base.columns]
    tau = rows @ theta
    rnea = dynamics.inverse_dynamics(ROBOT.model, *motion)
    return {
        "base_against_rnea": figure(
            float(np.abs(tau - rnea).max()),
            1e-9,
            STATES,
            unit="N m",
            parameters=len(base),
            gap=base.gap,
        ),
        "power_balance": figure(
            power_miss(ROBOT.model, motion, tau), 1e-6, STATES, unit="relative"
        ),
        "urdf_round_trip": figure(_round_trip(), 1e-9, 1, unit="N m"),
    }


def _round_trip() -> float:
    """Largest torque difference of an identified model once written and reloaded."""
    fit, held_out = plant_logs(1)
    found = identify(ROBOT, fit)
    names = list(dict.fromkeys(t.effect.name for t in found.model.terms))
    with tempfile.TemporaryDirectory() as folder:
        for name, content in robot_files(found.model).items():
            (Path(folder) / name).write_bytes(content)
        robot = load_robot(folder)
    again = start_nominal(
        prepare_logs(robot, fit, None, found.model.filters), names
    ).model
    same = ("speed_floor", "standstill", "clock")
    again = replace(again, **{key: getattr(found.model, key) for key in same})
    gaps = [np.abs(again.predict(r) - found.model.predict(r)).max() for r in held_out]
    return float(max(gaps))


def recovery_figures(quick: bool) -> Figures:
    """Identify arms whose parameters are 10 % off, and compare with what they are."""
    seeds = 2 if quick else 20
    rows = [_one(seed) for seed in range(1, seeds + 1)]
    of = {key: [row[key] for row in rows] for key in rows[0]}
    median = {key: float(np.median(values)) for key, values in of.items()}
    ratio = [c / f for c, f in zip(of["consistent"], of["free"], strict=True)]
    return {
        # Of noise-free torque on an unseen family: what noise cannot blur.
        "recovered_torque_over_nominal": figure(
            median["recovered"], None, seeds, all=of["recovered"]
        ),
        "error_in_standard_deviations": figure(
            median["z"], None, seeds, about=1.0, all=of["z"]
        ),
        "friction_error_percent": figure(median["friction"], None, seeds),
        "condition": figure(median["condition"], None, seeds),
        "held_out_percent": figure(
            median["free"], None, seeds, nominal=median["nominal"]
        ),
        "irls_held_out_percent": figure(median["irls"], None, seeds),
        "consistent_over_free": figure(
            float(np.median(ratio)), None, seeds, worst=float(max(ratio))
        ),
        "least_mass_matrix": figure(
            min(of["least"]),
            0.0,
            seeds,
            ok=min(of["least"]) > 0,
            at_least=True,
            poses=10_000,
            unit="kg m^2",
        ),
    }


def _one(seed: int) -> dict[str, float]:
    fit, held_out = plant_logs(seed)
    found = identify(ROBOT, fit)
    robust = identify(ROBOT, fit, options=Options("irls"))
    bodies = consistent(found)
    truth = true_coefficients(found.nominal, seed)
    theta = found.base.mapping @ truth
    fitted = found.estimate.sd > 0
    z = (found.estimate.theta - theta)[fitted] / found.estimate.sd[fitted]
    size = len(found.nominal.inertial)
    friction = [
        i
        for i, c in enumerate(found.base.columns)
        if c >= size and c < size + 2 * ROBOT.dof
    ]
    share = found.estimate.theta[friction] / theta[friction] - 1
    models = {"nominal": found.nominal, "free": found.model}
    models |= {"irls": robust.model, "consistent": bodies.model}
    errors = torque_errors(models, held_out)
    return {
        **{name: errors[name].overall("filtered") for name in models},
        "recovered": _recovered(found, truth, held_out),
        "z": float(np.sqrt(np.mean(z**2))),
        "friction": float(100 * np.sqrt(np.mean(share**2))),
        "condition": found.estimate.condition,
        "least": bodies.least_mass_matrix,
    }


def _recovered(found: Identification, truth: np.ndarray, held_out: list) -> float:
    """Torque by which the model is off the truth, over that of the nominal model."""
    true, misses = found.nominal.with_coefficients(truth), []
    for model in (found.model, found.nominal):
        tracks, _ = prepare(held_out, model.filters, model.speed_floor)
        gaps = [model.torque_on(t) - true.torque_on(t) for t in tracks]
        misses.append(float(np.linalg.norm(np.concatenate(gaps))))
    return misses[0] / misses[1]


_SPLITS = {"kr300": "kr300 AB | C", "ur10": "ur10 60 % | 40 %"}


def measured_figures(quick: bool) -> Figures:
    """Identify each arm freely and consistently, and try both on unseen motion."""
    folder, out = data_folder(), {}
    for name, split in _SPLITS.items():
        if folder is None or (quick and name == "kr300"):
            why = "no measured logs" if folder is None else "the full run measures it"
            out[f"{name}_consistent_over_free"] = missing(None, why)
            continue
        robot, logs = read_split(SPLITS[split])
        found = identify(robot, logs["fit"])
        bodies = consistent(found)
        models = {"nominal": found.nominal, "free": found.model}
        models["consistent"] = bodies.model
        errors = torque_errors(models, logs["held_out"])
        told = {k: round(e.overall("filtered"), 4) for k, e in errors.items()}
        out[f"{name}_consistent_over_free"] = figure(
            told["consistent"] / told["free"],
            None,
            1,
            held_out_percent=told,
            condition=found.estimate.condition,
            held=len(found.preflight.fixed),
            least_mass_matrix=bodies.least_mass_matrix,
        )
    return out
