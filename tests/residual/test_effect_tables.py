from dataclasses import replace

import numpy as np
import pytest

from residual.errors import InputError
from residual.tables.choose import fit_effect_tables
from residual.tables.crossval import leave_one_out
from residual.tables.figures import table_importance
from residual.tables.form import (
    LEAST_SQUARES,
    LOADED,
    MAIN,
    NAMED,
    NONE,
    PAIRS,
    WIDTHS,
    EffectForm,
    fit_base,
)
from residual.tables.levels import quantile_levels
from residual.tables.main_tables import (
    LEVELS,
    ROWS,
    add_pairs,
    make_pyramid,
    read_pairs,
)
from residual.tables.nominal_pls import NominalForm, fit_nominal_pls
from tests.residual.motion_blocks import NAMES, motion
from tests.residual.refit import held_out, nested_errors

TORQUES = ("tau1", "tau2", "tau3")
FORM = EffectForm(
    (3, 4, 5), names=NAMES, pairs=NominalForm(8, 4, "quantile", (3, 4, 5))
)


def test_friction_is_learnt_for_unseen_runs_where_the_paper_form_fails(rng):
    X, Y, torque, run = motion(rng, runs=4, rows=1000)
    folds = leave_one_out(run)
    none, ours = nested_errors(X, Y, folds, run, torque, FORM).pooled()
    assert (ours < 0.4 * none).all()

    def by_paper(X_train, Y_train, X_new):
        return fit_nominal_pls(X_train, Y_train, NominalForm(22, 8)).predict(X_new)[
            None
        ]

    paper = held_out(by_paper, X, Y, folds, torque).pooled()[0]
    assert (ours < 0.5 * paper).all()
    model = fit_effect_tables(X, Y, run, torque, FORM)
    assert {o.kind for o in model.chosen} <= {MAIN, NAMED, PAIRS}
    found = table_importance(model.lookup, X)
    assert max(found, key=lambda name: found[name][1]) == "qd2"


def test_where_nothing_is_left_nothing_is_chosen(rng):
    X, Y, torque, run = motion(rng, runs=4, rows=600, friction=0.0)
    model = fit_effect_tables(X, Y, run, torque, FORM)
    assert [o.kind for o in model.chosen] == [NONE] * 3
    assert not model.lookup.predict(X).any()
    assert model.lookup.tables == ()


def test_a_straight_line_is_left_to_least_squares(rng):
    X, _, torque, run = motion(rng, runs=4, rows=600)
    Y = np.c_[3 + 2 * X[:, 0] + X[:, 4] + 0.1 * rng.normal(size=len(X))]
    model = fit_effect_tables(X, Y, run, torque[:, :1], FORM)
    assert model.chosen[0].kind == LEAST_SQUARES
    assert np.abs(model.lookup.predict(X) - Y).max() < 0.6


def test_the_tables_equal_the_fits_that_they_are_made_of(rng):
    X, Y, torque, run = motion(rng, runs=3, rows=500)
    model = fit_effect_tables(X, Y, run, torque, FORM)
    base = fit_base(X, Y, FORM).predict(X, FORM)[1]
    for j, option in enumerate(model.chosen):
        assert option.kind in (MAIN, NAMED, PAIRS)
        expected = base[FORM.ridges.index(option.ridge), :, j]
        if option.kind != MAIN:
            first = 0 if option.kind == NAMED else FORM.named
            more = model.rest.predict(X, FORM)[first + option.count - 1, :, j]
            expected = expected + more
        np.testing.assert_allclose(model.lookup.predict(X)[:, j], expected, atol=1e-10)


def test_a_table_of_two_variables_is_found_and_named(rng):
    X, _, _, run = motion(rng, runs=4, rows=1500)
    pair = 6 * np.sign(X[:, 0]) * np.sign(X[:, 4])
    rest = pair + 0.5 * rng.normal(size=len(X))
    codes = quantile_levels(X, LEVELS, NAMES, velocities=(3, 4, 5)).encode(X)
    found = add_pairs(codes, rest, run)
    assert found[0].axes == (0, 4)
    assert np.std(rest - read_pairs(found, codes)[-1]) < 0.5 * np.std(rest)
    assert add_pairs(codes, rng.normal(size=len(X)), run) == ()


LOADS = replace(FORM, loads=((3, 9), (4, 10), (5, 11)), names=(*NAMES, *TORQUES))


def carried(X, Y):
    """X with a load that all joints decide, Y with friction that grows with it."""
    load = 40 * np.cos(X[:, :3].sum(axis=1, keepdims=True) + np.arange(3))
    return np.hstack([X, load]), Y + 0.3 * np.abs(load) * np.sign(X[:, 3:6])


def test_tables_of_speed_and_load_solve_the_ridge_equations(rng):
    X, Y, _, _ = motion(rng, runs=1, rows=400)
    X, Y = carried(X, Y)
    fit = fit_base(X, Y, LOADS).loaded[1]
    pyramid = make_pyramid(X[:, :9], LOADS.pyramid, velocities=(3, 4, 5))
    codes = pyramid.levels.encode(X[:, :9])
    Z = [
        np.eye(k)[c] @ root
        for k, c, root in zip(codes.sizes, codes.values.T, pyramid.roots, strict=True)
    ]
    pairs = LOADS.speeds_and_loads(X)
    found = fit.predict(X[:, :9], pairs)
    layers = [quantile_levels(pairs, k, velocities=(0, 2, 4)) for k in WIDTHS]
    for j in range(3):
        tables = []
        for layer in layers:
            k1, k2 = layer.sizes[2 * j : 2 * j + 2]
            c1, c2 = layer.encode(pairs).values[:, 2 * j : 2 * j + 2].astype(int).T
            tables.append(np.eye(k1 * k2)[c1 * k2 + c2])
        A = np.hstack([*Z, *tables])
        A -= A.mean(0)
        ridge = LOADS.ridges[1] * len(X) / ROWS * np.eye(A.shape[1])
        beta = np.linalg.solve(A.T @ A + ridge, A.T @ (Y[:, j] - Y[:, j].mean()))
        expected = Y[:, j].mean() + A @ beta
        np.testing.assert_allclose(found[:, j], expected, atol=1e-7)


def test_friction_that_grows_with_the_load_is_learnt_for_unseen_runs(rng):
    X, Y, torque, run = motion(rng, runs=4, rows=800)
    X, Y = carried(X, Y)
    folds = leave_one_out(run)
    _, ours = nested_errors(X, Y, folds, run, torque, LOADS).pooled()
    _, without = nested_errors(X[:, :9], Y, folds, run, torque, FORM).pooled()
    assert (ours < 0.7 * without).all()
    model = fit_effect_tables(X, Y, run, torque, LOADS)
    assert [o.kind for o in model.chosen] == [LOADED] * 3
    base = fit_base(X, Y, LOADS).predict(X, LOADS)[2]
    for j, option in enumerate(model.chosen):
        expected = base[LOADS.ridges.index(option.ridge), :, j]
        np.testing.assert_allclose(model.lookup.predict(X)[:, j], expected, atol=1e-9)


def test_a_joint_that_carries_nothing_has_no_table_of_load_and_is_no_error(rng):
    X, Y, torque, run = motion(rng, runs=4, rows=600)
    X, Y = carried(X, Y)
    X[:, 11] = 0.0
    model = fit_effect_tables(X, Y, run, torque, LOADS)
    assert [o.kind for o in model.chosen[:2]] == [LOADED] * 2
    assert np.isfinite(model.lookup.predict(X)).all()


def test_two_runs_prove_nothing_and_allow_only_what_helps_both(rng):
    X, Y, torque, run = motion(rng, runs=2, rows=800)
    model = fit_effect_tables(X, Y, run, torque, FORM)
    assert {o.kind for o in model.chosen} <= {NONE, MAIN}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"run": np.zeros(600)}, "different runs must be 2 to 600, got 1"),
        ({"form": EffectForm(pyramid=())}, "at least one number of levels"),
        ({"form": EffectForm(pyramid=(1, 5))}, "levels must be 2 to .*, got 1"),
        ({"form": EffectForm(ridges=(0.0,))}, "ridges must be above 0"),
        ({"form": EffectForm(names=("q1",))}, "1 names for 9 columns"),
        ({"torque": np.ones((5, 3))}, "folds are of 600 rows, the data of 5"),
    ],
)
def test_bad_input_is_refused(rng, change, message):
    X, Y, torque, run = motion(rng, runs=3, rows=200)
    given = {"X": X, "Y": Y, "run": run, "torque": torque, "form": FORM}
    with pytest.raises(InputError, match=message):
        fit_effect_tables(**given | change)


@pytest.mark.parametrize(
    ("moves", "message"), [(1, "all but run 1, 400 rows: qd2 = 0"), (None, "qd2 = 0")]
)
def test_a_joint_that_moves_in_one_run_or_none_is_refused_by_name(rng, moves, message):
    X, Y, torque, run = motion(rng, runs=3, rows=200)
    X[run != moves, 4] = 0
    with pytest.raises(InputError, match=message):
        fit_effect_tables(X, Y, run, torque, FORM)
