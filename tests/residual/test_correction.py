"""Tables on top of a model: they help where the state tells, and are none elsewhere."""

import numpy as np
import pytest

from residual.diagnosis.outcome import search_effects
from residual.diagnosis.unexplained import analyze_joint_remainders, fit_correction
from residual.model.compare import compute_model_errors, prepare_held_out
from residual.model.nominal import DEFAULT_DECLARED, prepare_fit_logs
from residual.model.nominal import build_free_nominal as free_nominal
from residual.signals.splitting import find_session_start
from residual.signals.track import FilterSettings
from tests.residual.arms import arm, plain_logs, quiet


def stopped(count=6):
    """Logs of two joints with a stop on joint 2, which no effect describes."""
    out = []
    for log in plain_logs(arm(), [0, 1], [0.0, 0.0], count=count):
        tau = log.tau.copy()
        q = log.q[:, 1]
        tau[:, 1] += 12 * np.maximum(q - 0.3, 0) + 8 * np.maximum(-0.2 - q, 0) ** 2
        out.append(type(log)(log.id, log.robot, log.t, log.q, tau))
    return out


def test_what_the_position_makes_is_corrected_on_logs_that_nobody_saw():
    every = stopped()
    fit, held = every[:4], every[4:]
    logs = prepare_fit_logs(arm(), fit, find_session_start(every), FilterSettings())
    nominal = free_nominal(logs, DEFAULT_DECLARED)
    outcome = search_effects(logs, nominal, quiet)
    design = outcome.design
    left = analyze_joint_remainders(design, logs.tracks, outcome.fit, outcome.adequacy)
    model = outcome.model(outcome.fit).model
    tables = fit_correction(model, logs.tracks, left)
    models = {"augmented": model, "plsr": tables}
    errors, _ = compute_model_errors(models, prepare_held_out(held, nominal.model), logs.filters)
    errors = {k: e.per_joint("filtered") for k, e in errors.items()}
    assert outcome.named == ()
    assert [one.joint for one in left] == [1]
    assert (left[0].curves[0].variable.on, left[0].kind) == ("q", "repeatable")
    assert tables.uncorrected_joints == ()
    assert errors["plsr"][1] < 0.6 * errors["augmented"][1]
    assert errors["plsr"][0] == pytest.approx(errors["augmented"][0])
