"""Taken out again: a right cause leaves the arm as it was, dense least squares not."""

from dataclasses import replace

import numpy as np
import pytest

from residual.effects import load_effects
from residual.evidence.design import Design
from residual.model.model import Term
from residual.model.nominal import build_free_nominal, prepare_fit_logs
from residual.robot.robot import load_robot
from residual.signals.track import FilterSettings
from residual.verdict.diagnosis import (
    fit_all_parameters,
    measure_errors,
    remove_effects_from_model,
    reset_effect_parameters,
)
from residual.verdict.result import Edit, Place
from sim.engine.plant_records import SyntheticEffect
from tests.synthetic.logs import LogPlan, make
from tests.synthetic.quasi_static import Plant

LOAD = {"mass": 3.0, "com_x": 0.0, "com_y": 0.0, "com_z": 0.1}


@pytest.fixture(scope="module")
def world():
    robot = load_robot("irb140")
    families = ("fourier", "cyclic")
    plan = [LogPlan(f"fit_{f}", "fit", f, duration=10.0, rate=125.0) for f in families]
    loaded, bare = (
        make(Plant(robot, hidden, 3, scatter=0.0), tuple(plan), 3)
        for hidden in ((SyntheticEffect("payload", (6,), LOAD),), ())
    )
    logs = prepare_fit_logs(robot, loaded, None, FilterSettings())
    nominal = build_free_nominal(logs, tuple(robot.declared)).model
    numbers = [LOAD.get(key, 0.0) for key in load_effects()["payload"].parameters]
    theta, shape = load_effects()["payload"].from_values(np.array(numbers), robot)
    load = Term(load_effects()["payload"], (5,), shape, theta)
    augmented = replace(nominal, terms=(*nominal.terms, load))
    models = {"nominal": nominal, "augmented": augmented}
    dense = fit_all_parameters(Design(logs.tracks, nominal))
    return models | {"dense": dense}, loaded, bare


def _edit_on_the_arm_without(effect, models, logs) -> Edit:
    """Take an effect out of each model, and predict the arm that has all but it."""
    augmented, dense, nominal = (models[k] for k in ("augmented", "dense", "nominal"))
    errors = measure_errors(
        {
            "edited": remove_effects_from_model(augmented, [effect]),
            "kept": augmented,
            "dense": reset_effect_parameters(dense, nominal, effect),
            "oracle": models.get("oracle"),
        },
        logs,
    )
    return Edit(effect.name, effect.joints, *errors.values())


def test_dense_least_squares_fits_as_well_and_fails_the_edit(world):
    models, loaded, bare = world
    fitted = measure_errors(models, loaded)
    assert fitted["dense"] < 1.1 * fitted["augmented"]
    edit = _edit_on_the_arm_without(Place("payload", (6,)), models, bare)
    assert edit.error < 1.1 * measure_errors(models, bare)["nominal"]
    assert edit.least_squares > 3 * edit.error
    assert edit.kept > 3 * edit.error
    assert edit.reference is None
