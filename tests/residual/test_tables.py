"""Tables of corrections: their choice, their look-up, and the model that they correct."""

import io
import json
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from residual.calibration.calibrate import build_corrected_model
from residual.calibration.calibration_rows import MEASURED, PAPER, name_state_columns
from residual.calibration.correction_choice import (
    MAIN,
    PAIRS,
    ROWS,
    CorrectionOption,
    TrainingRows,
    choose_table_levels,
    fit_all_corrections,
    fit_chosen_tables,
)
from residual.calibration.nominal_pls import NominalPlsForm, fit_nominal_pls
from residual.errors import InputError
from residual.export.model_export import build_reference_motion
from residual.model.lookup import NEAREST, NONE, LevelAxis, Lookup, LookupTable, build_lookup_files
from tests.exports.models import model_with, robot_of
from tests.residual.motion_blocks import NAMES, motion

# Our form of tables, and the one choice of a correction for each joint.


ALL = (*NAMES, "tau1", "tau2", "tau3")
SPEEDS = (3, 4, 5)


def training(X, Y, load, moving=None):
    tables = choose_table_levels(X, load, SPEEDS[: Y.shape[1]], ALL[: 9 + Y.shape[1]])
    second = np.arange(len(X)) // 20
    Z = tables.encode(X, load)
    return TrainingRows(X, Y, load + Y, second, Z, moving), tables


def fitted(X, Y, load):
    return fit_all_corrections(*training(X, Y, load))


def carried(X, Y):
    """A load that all joints decide, and Y with friction that grows with it."""
    load = 40 * np.cos(X[:, :3].sum(axis=1, keepdims=True) + np.arange(3))
    return load, Y + 0.3 * np.abs(load) * np.sign(X[:, 3:6])


def chosen(X, Y, load, run):
    data, tables = training(X, Y, load)
    return fit_chosen_tables(data, run, tables)


def unseen(X, Y, load, run):
    """What is left of each run by a choice among the others, over what was there."""
    left = 0.0
    for one in np.unique(run):
        out = run == one
        lookup, _ = chosen(X[~out], Y[~out], load[~out], run[~out])
        own = np.hstack([X, load])[out][:, : len(lookup.names)]
        left = left + ((Y[out] - lookup.predict(own)) ** 2).sum(axis=0)
    return np.sqrt(left / (Y**2).sum(axis=0))


def test_friction_is_learnt_for_unseen_runs_where_the_paper_form_fails(rng):
    X, Y, torque, run = motion(rng, runs=4, rows=1000)
    ours = unseen(X, Y, torque, run)
    assert (ours < 0.4).all()
    left = 0.0
    for one in range(4):
        out = run == one
        model = fit_nominal_pls(X[~out], Y[~out], NominalPlsForm(22, 8))
        left = left + ((Y[out] - model.predict(X[out])) ** 2).sum(axis=0)
    assert (ours < 0.5 * np.sqrt(left / (Y**2).sum(axis=0))).all()
    _, options = chosen(X, Y, torque, run)
    assert {o.kind for o in options} <= {MAIN, PAIRS}


def test_friction_that_grows_with_the_load_takes_a_table_of_speed_and_load(rng):
    X, Y, _, run = motion(rng, runs=4, rows=800)
    load, Y = carried(X, Y)
    lookup, options = chosen(X, Y, load, run)
    assert [o.kind for o in options] == [PAIRS] * 3
    assert lookup.names == ALL
    assert (unseen(X, Y, load, run) < 0.35).all()


def test_where_nothing_is_left_nothing_is_chosen(rng):
    X, Y, torque, run = motion(rng, runs=4, rows=600, friction=0.0)
    lookup, options = chosen(X, Y, torque, run)
    assert [o.kind for o in options] == [NONE] * 3
    assert not lookup.predict(X).any()
    assert lookup.tables == ()


def test_what_holds_in_one_run_alone_is_not_taken(rng):
    X, Y, torque, run = motion(rng, runs=4, rows=600)
    _, options = chosen(X, np.where(run[:, None] % 2 == 0, Y, -Y), torque, run)
    assert [o.kind for o in options] == [NONE] * 3


@pytest.mark.parametrize("kind", [MAIN, PAIRS])
def test_tables_solve_the_ridge_equations(rng, kind):
    X, Y, _, _ = motion(rng, runs=1, rows=400)
    load, Y = carried(X, Y)
    data, tables = training(X, Y, load)
    forecasts = fit_all_corrections(data, tables).forecasts(data, [CorrectionOption(kind, 200.0)])[
        0
    ]
    Z, count = data.Z.toarray(), len(tables.state_penalty)
    for j in range(3):
        own = list(range(count))
        penalty = tables.state_penalty
        if kind == PAIRS:
            own += range(*tables.starts[9 + j : 11 + j])
            more = tables.paired[j]
            penalty = np.block(
                [[penalty, np.zeros((count, len(more)))], [np.zeros((len(more), count)), more]]
            )
        A = Z[:, own] - Z[:, own].mean(axis=0)
        ridge = 200.0 * len(X) / ROWS * penalty
        g = np.linalg.solve(A.T @ A + ridge, A.T @ (Y[:, j] - Y[:, j].mean()))
        np.testing.assert_allclose(forecasts[:, j], Y[:, j].mean() + A @ g, atol=1e-7)


def standing(rng):
    """Noise, and at standstill friction that one sees in no other motion."""
    X, Y, torque, run = motion(rng, runs=4, rows=400, friction=0.0, noise=0.1)
    moving = np.abs(X[:, 3:6]) > 0.4
    Y = np.where(moving, Y, -4 * np.sign(X[:, 3:6]))
    return X, Y, torque, run, moving


def test_what_is_left_at_standstill_alone_is_no_table(rng):
    X, Y, torque, run, moving = standing(rng)
    _, options = chosen(X, Y, torque, run)
    assert NONE not in {o.kind for o in options}
    data, tables = training(X, Y, torque, moving)
    taught = replace(data.with_fitted_standstill(), moving=moving)
    _, options = fit_chosen_tables(taught, run, tables)
    assert [o.kind for o in options] == [NONE] * 3


@pytest.mark.parametrize(
    ("X", "message"),
    [
        (np.full((9, 9), np.nan), "NaN or infinite in row 0"),
        (np.ones((9, 9)), "constant over all 9 rows: q1 = 1"),
    ],
)
def test_bad_input_is_refused(X, message):
    with pytest.raises(InputError, match=message):
        choose_table_levels(X, np.ones((9, 3)), SPEEDS, ALL)


EXACT = {"rtol": 0, "atol": 1e-12}


@pytest.fixture(scope="module")
def block():
    return motion(np.random.default_rng(5), runs=3, rows=400)


@pytest.fixture(scope="module")
def model(block):
    return fit_nominal_pls(block[0], block[1], NominalPlsForm(9, 5))


@pytest.mark.parametrize("components", [1, 5, None])
def test_tables_equal_the_paper_form(block, model, components):
    lookup = model.lookup(components)
    expected = model.predict(block[0], components)
    np.testing.assert_allclose(lookup.predict(block[0]), expected, **EXACT)


@pytest.mark.parametrize("joints", [1, 3, 4, 6])
def test_any_number_of_joints_and_kinds_of_table_add_up(rng, joints):
    edges = np.array([-0.5, 0.0, 0.001, 0.7])
    one, two = rng.normal(size=(5, joints)), rng.normal(size=(5, 2, joints))
    slope, offset = rng.normal(size=(3, joints)), rng.normal(size=joints)
    lookup = Lookup(
        ("a", "b", "c"),
        tuple(f"joint {j}" for j in range(joints)),
        (LevelAxis(2, edges), LevelAxis(0, np.array([0.25]))),
        (LookupTable((0,), one), LookupTable((0, 1), two)),
        offset,
        slope,
        np.array([-1.0, -1, -1]),
        np.array([1.0, 1, 1]),
    )
    X = rng.normal(size=(200, 3))
    X[:5, 2] = [*edges.tolist(), np.nextafter(0.7, 0)]
    i, j = np.searchsorted(edges, X[:, 2], "right"), (X[:, 0] >= 0.25).astype(int)
    expected = offset + X @ slope + one[i] + two[i, j]
    np.testing.assert_allclose(lookup.predict(X), expected, **EXACT)
    np.testing.assert_array_equal(lookup.outside(X), np.abs(X) > 1)


def _evaluated(files, tmp_path, X):
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    np.savetxt(tmp_path / "rows.csv", X, "%.17g", delimiter=",")
    # -I: neither this folder nor PYTHONPATH, so that our package cannot be found.
    words = [sys.executable, "-I", "evaluate.py", "model.npz", "rows.csv"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert done.stderr == ""
    return np.loadtxt(io.StringIO(done.stdout), delimiter=",", ndmin=2)


def test_the_export_evaluates_on_its_own(block, model, tmp_path):
    X, Y, torque, _ = block
    files = build_lookup_files(model.lookup())
    assert set(files) == {"model.npz", "tables.csv", "model.json", "evaluate.py"}
    assert files == build_lookup_files(model.lookup())
    document = json.loads(files["model.json"])
    assert document["tables"][0]["variables"] == ["x1", "x2"]
    assert [len(axis["edges"]) for axis in document["axes"]] == [8] * 9
    assert "residual" not in files["evaluate.py"].decode()
    evaluated = _evaluated(files, tmp_path, X[::20])
    np.testing.assert_allclose(evaluated, model.predict(X[::20]), **EXACT)
    own = fitted(X, Y, torque).lookup([CorrectionOption(MAIN, 20.0)] * 3)
    evaluated = _evaluated(build_lookup_files(own), tmp_path, X[::20])
    np.testing.assert_allclose(evaluated, own.predict(X[::20]), **EXACT)


def test_bad_rows_are_refused(model):
    lookup = model.lookup()
    with pytest.raises(InputError, match="X has 2 columns, the tables are of 9"):
        lookup.predict(np.ones((3, 2)))
    with pytest.raises(InputError, match="NaN or infinite in row 0"):
        lookup.predict(np.full((1, 9), np.nan))
    with pytest.raises(InputError, match="components must be 0 to 5, got 6"):
        model.lookup(6)


# The tables of a calibration on the model that they correct are one torque.


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
