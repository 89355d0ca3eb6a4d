"""Levels and components by unseen runs, sparse weights, and cells nobody visited."""

from dataclasses import replace

import numpy as np
import pytest

from residual.errors import InputError
from residual.tables.crossval import leave_one_out
from residual.tables.levels import equal_levels, quantile_levels
from residual.tables.nominal_choice import choose_levels, nominal_errors
from residual.tables.nominal_pls import NominalForm, fill_unvisited, fit_nominal_pls
from tests.residual.refit import held_out


def step_rows(seed=0, runs=4, rows=300):
    """Rows whose response is a step of one variable of three, at zero."""
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(runs), rows)
    X = rng.uniform(-1, 1, (len(run), 3))
    noise = rng.normal(size=(len(run), 2))
    Y = np.stack([4 * np.sign(X[:, 1]), 2 * np.sign(X[:, 1])], axis=1) + 0.3 * noise
    return X, Y, run


def test_every_variable_has_levels_of_its_own():
    X, _, _ = step_rows()
    assert equal_levels(X, (2, 5, 3)).sizes == (2, 5, 3)
    assert quantile_levels(X, (2, 5, 3)).sizes == (2, 5, 3)
    with pytest.raises(InputError, match="of 2 variables, the rows of 3"):
        equal_levels(X, (2, 5))
    with pytest.raises(InputError, match="levels"):
        equal_levels(X, (2, 1, 3))


def test_the_levels_of_a_step_are_few_and_as_good_as_the_best_of_the_sweep():
    X, Y, run = step_rows()
    form, sweep = NominalForm(components=4), (2, 3, 4, 8, 16)
    chosen = choose_levels(X, Y, run, Y, form, sweep)
    assert chosen.common == 2
    assert chosen.components >= 1
    # On rows that nobody chose by.
    new, truth, fresh = step_rows(seed=1)

    def error(made):
        folds = [leave_one_out(fresh)]
        (found,) = nominal_errors(new, truth, folds, truth, made)
        return float(found.miss[-1].sum())

    own = error(chosen.form)
    rest = [error(replace(form, levels=k, components=4)) for k in sweep]
    assert own <= 1.02 * min(rest)


def test_nothing_is_chosen_where_there_is_nothing():
    X, _, run = step_rows()
    Y = np.random.default_rng(5).normal(size=(len(X), 2))
    chosen = choose_levels(X, Y, run, Y, NominalForm(components=3), (2, 4))
    assert chosen.components == 0


def test_sparse_weights_are_few_and_scores_stay_orthogonal():
    X, Y, _ = step_rows()
    dense = fit_nominal_pls(X, Y, NominalForm(8, 4))
    sparse = fit_nominal_pls(X, Y, NominalForm(8, 4, sparsity=0.6))
    few, many = ((m.coefficients() != 0).any(axis=1).sum() for m in (sparse, dense))
    assert few < 0.6 * many
    T = sparse.transform(X)
    np.testing.assert_allclose(T.T @ T, np.diag(sparse.energy), atol=1e-8)
    # The first direction by hand: soft-thresholded products of columns and responses.
    S = (dense.V[0] != 0) * dense.V[0]
    soft = np.sign(S) * np.maximum(np.abs(S) - 0.6 * np.abs(S).max(), 0)
    np.testing.assert_allclose(sparse.V[0], soft / np.linalg.norm(soft), atol=1e-9)
    with pytest.raises(InputError, match="sparsity"):
        fit_nominal_pls(X, Y, NominalForm(8, 4, sparsity=1.0))


def test_errors_of_all_folds_at_once_are_those_of_sparse_fits_one_by_one():
    X, Y, run = step_rows()
    form = NominalForm(6, 3, sparsity=0.5)
    folds = leave_one_out(run)
    (found,) = nominal_errors(X, Y, [folds], Y, form)
    levels = form.make_levels(X)

    def one_by_one(X, Y, new):
        model = fit_nominal_pls(X, Y, form, levels)
        return np.stack([model.predict(new, a) for a in range(4)])

    expected = held_out(one_by_one, X, Y, folds, Y)
    np.testing.assert_allclose(found.miss, expected.miss, rtol=1e-8)


def test_cells_that_no_row_visited_take_the_mean_of_the_coarser_cell():
    rng = np.random.default_rng(3)
    X = rng.uniform(-1, 1, (600, 2))
    X = X[~((X[:, 0] > 0.45) & (X[:, 1] > 0.45))]  # the last cell of four by four
    Y = np.sign(X[:, :1]) + np.sign(X[:, 1:])
    model = fit_nominal_pls(X, Y, NominalForm(4, 3))
    filled = fill_unvisited(model)
    np.testing.assert_array_equal(filled.predict(X), model.predict(X))
    B, share = filled.coefficients()[:, 0], model.x_mean
    assert model.coefficients()[-1, 0] == 0
    near = [10, 11, 14]  # the visited ones of the same coarser cell
    assert B[15] == pytest.approx(np.average(B[near], weights=share[near]))
    there = np.array([[0.9, 0.9]])
    assert abs(filled.predict(there)[0, 0] - 2) < abs(model.predict(there)[0, 0] - 2)
