"""Tables on top of a model: they help where the state tells, and are none elsewhere."""

import numpy as np
import pytest

from residual.diagnosis.outcome import examine
from residual.diagnosis.unexplained import fit_correction, joint_leftovers
from residual.evidence.thresholds import EvidenceThresholds
from residual.model.compare import compare, prepare_held_out
from residual.model.nominal import DEFAULT_DECLARED, prepare_logs, start_nominal
from residual.signals.splitting import session_clock
from residual.signals.track import Filters
from tests.residual.arms import arm, plain_logs, quiet

WALL, KNOCK = "a stop", "a knock"


def logs_with(kind, count=6):
    """Logs of two joints with something on joint 2 that no effect describes."""
    out = []
    for log in plain_logs(arm(), [0, 1], [0.0, 0.0], count=count):
        tau = log.tau.copy()
        q = log.q[:, 1]
        if kind == WALL:
            tau[:, 1] += 12 * np.maximum(q - 0.3, 0) + 8 * np.maximum(-0.2 - q, 0) ** 2
        else:
            tau[:, 1] += 2 * np.sign(np.sin(2 * np.pi * 0.7 * log.t))
        out.append(type(log)(log.id, log.robot, log.t, log.q, tau))
    return out


@pytest.fixture(scope="module")
def made():
    """Of each kind: the nominal structure fitted alone, and what was made of it."""
    done = {}
    for kind in (WALL, KNOCK):
        every = logs_with(kind)
        fit, held = every[:4], every[4:]
        logs = prepare_logs(arm(), fit, session_clock(every), Filters())
        nominal = start_nominal(logs, DEFAULT_DECLARED)
        diagnosis = examine(logs, nominal, EvidenceThresholds(max_effects=0), quiet)
        told, design = diagnosis.adequacy, diagnosis.task.design
        left = joint_leftovers(design, logs.tracks, diagnosis.fit, told)
        model = diagnosis.model(diagnosis.fit).model
        tables = fit_correction(model, logs.tracks, left)
        models = {"augmented": model, "plsr": tables}
        errors, _ = compare(models, prepare_held_out(held, nominal.model), logs.filters)
        errors = {k: e.per_joint("filtered") for k, e in errors.items()}
        done[kind] = (diagnosis, left, tables, errors)
    return done


def test_what_the_position_makes_is_corrected_on_logs_that_nobody_saw(made):
    _, left, tables, errors = made[WALL]
    assert [one.joint for one in left] == [1]
    assert (left[0].curves[0].variable.on, left[0].kind) == ("q", "repeatable")
    assert tables.helpless == ()
    assert errors["plsr"][1] < 0.6 * errors["augmented"][1]
    assert errors["plsr"][0] == pytest.approx(errors["augmented"][0])


def test_what_time_makes_is_left_alone(made):
    _, left, tables, errors = made[KNOCK]
    assert [one.joint for one in left] == [1]
    assert (left[0].curves, left[0].kind) == ((), "time-driven")
    assert tables.helpless == (1,)
    np.testing.assert_array_equal(errors["plsr"], errors["augmented"])
