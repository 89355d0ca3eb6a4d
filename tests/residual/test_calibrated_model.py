"""The tables of a calibration on the model that they correct are one torque."""

from types import SimpleNamespace

import numpy as np
import pytest

from residual.calibration.calibrate import build_corrected_model
from residual.calibration.calibration_rows import MEASURED, PAPER, name_state_columns
from residual.export.model_export import build_reference_motion
from residual.model.lookup import NEAREST, LevelAxis, Lookup, LookupTable
from tests.exports.models import model_with, robot_of

JOINTS = (1, 2, 3, 4, 5, 6)


def _lookup(rng) -> Lookup:
    """Tables of a speed, of a pair, and of speed and load; of joint 2 there is none."""
    names = (*name_state_columns(JOINTS), *(f"tau{j}" for j in JOINTS))
    axes = [(6, 0.3), (1, 0.2), (8, 0.3), (20, 9.0)]
    values = [rng.normal(size=(5, 6)), rng.normal(size=(5, 5, 6))]
    values.append(rng.normal(size=(5, 5, 6)))
    for each in values:
        each[..., 1] = 0
    slope = np.zeros((len(names), 6))
    slope[3, 4] = 0.5
    return Lookup(
        names,
        tuple(f"joint {j}" for j in JOINTS),
        tuple(LevelAxis(k, width * np.array([-2.0, -1.0, 1.0, 2.0])) for k, width in axes),
        tuple(LookupTable(a, v) for a, v in zip(((0,), (0, 1), (2, 3)), values, strict=True)),
        np.array([0.1, 0.0, 0.3, 0.4, 0.5, 0.6]),
        slope,
        np.full(len(names), -1.0),
        np.full(len(names), 1.0),
    )


def _calibration(mode=MEASURED, nominal=None):
    rows = SimpleNamespace(mode=mode, joints=JOINTS)
    lookup = _lookup(np.random.default_rng(5))
    return SimpleNamespace(rows=rows, nominal=nominal, lookup=lookup)


def _model(*more):
    return model_with(robot_of("irb140"), "viscous", "load_friction", *more)


def test_the_torque_is_that_of_the_model_and_of_the_tables_at_their_nearest_level():
    model, motion = _model(), build_reference_motion(robot_of("irb140"))
    calibration = _calibration(nominal=model)
    own = model.along(motion.t, motion.parts)
    X = np.hstack([*motion.parts, own])
    assert (X < -1).any()  # beyond the range of the tables
    want = own + calibration.lookup.predict(X)
    source = build_corrected_model(calibration)
    assert {t.beyond for t in source.tables} == {NEAREST}
    np.testing.assert_allclose(source.along(motion.t, motion.parts), want, atol=1e-11)


@pytest.mark.parametrize(
    "made",
    [
        _calibration(PAPER, _model()),
        _calibration(nominal=None),
        _calibration(nominal=_model("torque_gain")),
    ],
    ids=["a twin", "no model", "a torque as reported"],
)
def test_tables_that_correct_something_else_make_no_model(made):
    assert build_corrected_model(made) is None
