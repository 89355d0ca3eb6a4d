"""Taken out again: a right cause leaves the arm as it was, dense least squares not."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.logs import LogPlan, make
from benchmarks.synthetic.quasi_static import Plant
from residual.effects import registry
from residual.evidence.design import Design
from residual.model.model import Term
from residual.model.nominal import prepare_logs, start_nominal
from residual.robot.robot import load_robot
from residual.signals.track import Filters
from residual.verdict.edit import (
    baseline_edits,
    dense_fit,
    edited,
    errors_on,
    set_back,
)
from residual.verdict.result import Edit, Place
from sim.engine.records import Hidden

LOAD = {"mass": 3.0, "com_x": 0.0, "com_y": 0.0, "com_z": 0.1}


@pytest.fixture(scope="module")
def world():
    robot = load_robot("irb140")
    plan = [
        LogPlan(f"fit_{f}", "fit", f, duration=10.0, rate=125.0)
        for f in ("fourier", "cyclic")
    ]
    loaded, bare = (
        make(Plant(robot, hidden, 3, scatter=0.0), tuple(plan), 3)
        for hidden in ((Hidden("payload", (6,), LOAD),), ())
    )
    logs = prepare_logs(robot, loaded, None, Filters())
    nominal = start_nominal(logs, tuple(robot.declared)).model
    numbers = [LOAD.get(key, 0.0) for key in registry()["payload"].parameters]
    theta, shape = registry()["payload"].from_values(np.array(numbers), robot)
    load = Term(registry()["payload"], (5,), shape, theta)
    augmented = replace(nominal, terms=(*nominal.terms, load))
    models = {"nominal": nominal, "augmented": augmented}
    return models | {"dense": dense_fit(Design(logs.tracks, nominal))}, loaded, bare


def _edit_on_the_arm_without(effect, models, logs) -> Edit:
    """Take an effect out of each model, and predict the arm that has all but it."""
    augmented, dense, nominal = (models[k] for k in ("augmented", "dense", "nominal"))
    errors = errors_on(
        {
            "edited": edited(augmented, [effect]),
            "kept": augmented,
            "dense": set_back(dense, nominal, effect),
            "oracle": models.get("oracle"),
        },
        logs,
    )
    return Edit(effect.name, effect.joints, *errors.values())


def test_dense_least_squares_fits_as_well_and_fails_the_edit(world):
    models, loaded, bare = world
    fitted = errors_on(models, loaded)
    assert fitted["dense"] < 1.1 * fitted["augmented"]
    edit = _edit_on_the_arm_without(Place("payload", (6,)), models, bare)
    assert edit.error < 1.1 * errors_on(models, bare)["nominal"]
    assert edit.least_squares > 3 * edit.error
    assert edit.kept > 3 * edit.error
    assert edit.reference is None


def test_against_a_baseline_all_that_was_found_goes(world):
    models, _, bare = world
    spring = Term(registry()["spring"], (1,), (), np.array([30.0, 0.0]))
    wrong = replace(models["augmented"], terms=(*models["augmented"].terms, spring))
    named, background = [Place("payload", (6,))], [Place("spring", (2,))]
    pair = {"nominal": models["nominal"], "augmented": wrong}
    (edit,) = baseline_edits(pair, models["dense"], named, background, bare)
    assert edit.error == pytest.approx(edit.reference, rel=0.01)
    assert edit.least_squares > 3 * edit.error
    assert edit.kept > 3 * edit.error
