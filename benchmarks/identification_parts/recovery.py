"""Group 2: the truth of the plant, found again; and what consistency costs."""

import numpy as np

from benchmarks.harness.figures import Figures, figure, missing
from benchmarks.identification_parts.identities import (
    ROBOT,
    plant_logs,
    true_coefficients,
)
from benchmarks.measured_parts.arms import data_folder
from residual.identification.consistency import consistent
from residual.identification.estimate import Options
from residual.identification.identify import Identification, identify
from residual.identification.prove import torque_errors
from residual.model.model import Model
from residual.robot.robot import load_robot
from residual.signals.track import prepare
from warehouse.logs import read_log


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
    models = {
        "nominal": found.nominal,
        "free": found.model,
        "irls": robust.model,
        "consistent": bodies.model,
    }
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
    true = found.nominal.with_coefficients(truth)
    miss = [_gap(model, true, held_out) for model in (found.model, found.nominal)]
    return miss[0] / miss[1]


def _gap(model: Model, true: Model, held_out: list) -> float:
    tracks, _ = prepare(held_out, model.filters, model.speed_floor)
    gaps = [model.torque_on(t) - true.torque_on(t) for t in tracks]
    return float(np.linalg.norm(np.concatenate(gaps)))


_SPLITS = {
    "kr300": (("run_A.csv", "run_B.csv"), ("run_C.csv",)),
    "ur10": (("run.csv@:60%",), ("run.csv@60%:",)),
}


def measured_figures(quick: bool) -> Figures:
    """Identify each arm freely and consistently, and try both on unseen motion.

    Args:
        quick: Whether to take the smaller arm only.
    """
    folder, out = data_folder(), {}
    for name, parts in _SPLITS.items():
        if folder is None or (quick and name == "kr300"):
            why = "no measured logs" if folder is None else "the full run measures it"
            out[f"{name}_consistent_over_free"] = missing(None, why)
            continue
        robot = load_robot(folder / name / f"{name}.urdf")
        fit, held_out = (
            [read_log(f"{folder / name / word}", robot)[0] for word in part]
            for part in parts
        )
        found = identify(robot, fit)
        bodies = consistent(found)
        models = {
            "nominal": found.nominal,
            "free": found.model,
            "consistent": bodies.model,
        }
        errors = torque_errors(models, held_out)
        told = {k: round(e.overall("filtered"), 4) for k, e in errors.items()}
        out[f"{name}_consistent_over_free"] = figure(
            told["consistent"] / told["free"],
            None,
            1,
            held_out_percent=told,
            condition=found.estimate.condition,
            held=len(found.preflight.held),
            least_mass_matrix=bodies.least_mass_matrix,
        )
    return out
