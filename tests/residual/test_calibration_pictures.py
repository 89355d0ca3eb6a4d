"""Scores and loadings of PLSR."""

import numpy as np

from flows.report.words.calibration import plane_words
from residual.calibration.choice import Training
from residual.calibration.views import plane_of

NAMES = ("q1", "q2", "qd1", "qd2", "qdd1", "qdd2")


def states(seed=0, rows=800):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(rows, 6))
    run = np.repeat([0, 1], rows // 2)
    return X, run, rng


def test_a_residual_that_is_friction_goes_with_its_speed_and_is_said_to():
    X, run, rng = states()
    Y = np.column_stack([5 * X[:, 2], 0.1 * rng.normal(size=len(X))])
    plane = plane_of(Training(X, Y, run, Y, run, run), NAMES, (1, 2))
    place = {name: i for i, name in enumerate(plane.names)}
    for name in ("qd1", "residual1"):
        assert abs(plane.loadings[place[name], 0]) > 0.98
    assert abs(plane.loadings[place["qd2"], 0]) < 0.2
    assert plane.explained[0] > 95
    assert np.all(plane.explained >= 0)
    assert plane.explained.sum() <= 100 + 1e-9
    first = plane_words(plane)[0]
    assert "goes with qd1 (" in first
    assert "friction is wrong or missing" in first
