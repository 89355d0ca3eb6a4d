"""Group 2: the truth of the plant, found again; and what consistency costs."""

import numpy as np

from benchmarks.figures import Figures, figure
from benchmarks.identification_parts.plant_logs import (
    ROBOT,
    plant_logs,
    true_coefficients,
)
from residual.identification.consistency import consistent
from residual.identification.estimate import Options
from residual.identification.identify import Identification, identify
from residual.identification.prove import torque_errors
from residual.model.model import Model
from residual.signals.track import prepare


def recovery_figures(seeds: int) -> Figures:
    """Identify arms whose parameters are 10 % off, and compare with what they are."""
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
