"""Our form of tables, and the one choice of a correction for each joint."""

from dataclasses import replace

import numpy as np
import pytest

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
from residual.model.lookup import NONE
from tests.residual.motion_blocks import NAMES, motion

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
