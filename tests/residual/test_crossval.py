import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from residual.errors import InputError
from residual.tables.crossval import (
    HeldOut,
    held_out,
    leave_one_out,
    optimal_count,
    random_blocks,
    relative_error,
    simplest,
    systematic,
    systematic_repeats,
)
from residual.tables.jackknife import jackknife, jackknife_nominal
from residual.tables.nominal.pls import NominalForm
from residual.tables.outliers import pls_distances, spe_limit
from residual.tables.pls import fit_pls
from tests.residual.motion_blocks import motion


@given(st.integers(2, 60), st.integers(2, 20), st.integers(0, 99))
@settings(max_examples=40, deadline=None)
def test_every_row_is_held_out_once_in_folds_of_equal_size(rows, blocks, seed):
    if blocks > rows:
        blocks = rows
    rng = np.random.default_rng(seed)
    for folds in (systematic(rows, blocks), random_blocks(rows, rng, blocks)):
        sizes = np.bincount(folds.of_row, minlength=folds.count)
        assert folds.count == len(folds.names) == blocks
        assert np.ptp(sizes) <= 1
    assert (np.diff(systematic(rows, blocks).of_row) >= 0).all()


def test_repeats_of_a_block_are_left_out_together():
    run = np.repeat([0, 1], 40)
    folds = systematic_repeats(run, {0: 20, 1: 10}, blocks=8)
    assert folds.count == 8
    np.testing.assert_array_equal(folds.of_row[:20], folds.of_row[20:40])
    np.testing.assert_array_equal(folds.of_row[40:50], folds.of_row[70:80])
    assert folds.of_row[:5].tolist() == [0] * 5
    assert not set(folds.of_row[:40]) & set(folds.of_row[40:])


def test_a_run_is_left_out_whole():
    folds = leave_one_out(np.array(["b", "a", "b", "c"]))
    assert folds.names == ("a", "b", "c")
    assert folds.of_row.tolist() == [1, 0, 1, 2]


def test_errors_are_relative_to_torque_pooled_and_by_subset(rng):
    X, Y = np.zeros((6, 1)), np.full((6, 1), 3.0)
    torque = np.array([[3.0], [3], [3], [6], [6], [6]])
    folds = systematic(6, 2)
    errors = held_out(lambda a, b, c: np.zeros((1, len(c), 1)), X, Y, folds, torque)
    assert errors.pooled()[0, 0] == pytest.approx(100 * np.sqrt(54 / (27 + 108)))
    assert errors.mean_of_subsets()[0, 0] == pytest.approx(75.0)
    assert np.isnan(relative_error(np.ones(1), np.zeros(1))).all()


def test_what_is_predicted_was_not_in_the_fit():
    X = np.arange(6.0)[:, None]
    folds = systematic(6, 3)

    def predict(X_train, Y_train, X_new):
        assert not set(X_train[:, 0]) & set(X_new[:, 0])
        return X_new[None]

    assert held_out(predict, X, X, folds, X).miss.sum() == 0


def held(miss):
    miss = np.asarray(miss, float)[:, :, None]
    return HeldOut("run", miss, np.ones((miss.shape[1], 1)))


def test_the_best_count_has_least_error_and_the_simplest_is_within_its_doubt():
    clear = held([[9, 9, 9], [1, 1.2, 0.8], [0.99, 1.19, 0.81]])
    assert optimal_count(clear) == 2
    assert simplest(clear, 0) == 1
    assert simplest(held([[1, 1, 1], [0.5, 0.5, 1.6]]), 0) == 0
    assert simplest(held([[1, 1, 1], [0.5, 0.5, 0.6]]), 0) == 1
    assert simplest(held([[1, 1, 1], [0.99, 0.99, 0.99]]), 0) == 0


def test_the_jack_knife_gives_the_standard_error_of_a_mean(rng):
    x = rng.normal(size=30)
    left = np.array([np.delete(x, i).mean() for i in range(30)])
    found = jackknife(left, x.mean())
    assert found.errors == pytest.approx(x.std(ddof=1) / np.sqrt(30))
    constant = jackknife(np.ones((3, 2)) * [0, 1], np.array([0.0, 1.0]))
    assert constant.significant.tolist() == [False, True]


def test_over_random_rows_cells_look_significant_that_are_not_over_runs(rng):
    X, Y, _, run = motion(rng, runs=4, rows=300)
    form = NominalForm(8, 4)
    runs = jackknife_nominal(X, Y, leave_one_out(run), form)
    rows = jackknife_nominal(X, Y, random_blocks(len(X), rng), form)
    assert runs.values.shape == rows.values.shape
    assert rows.significant.mean() > 5 * runs.significant.mean()


def test_spoilt_rows_are_outliers_of_x_or_of_y(rng):
    X = rng.normal(size=(300, 2)) @ rng.normal(size=(2, 5))
    X += 0.1 * rng.normal(size=X.shape)
    Y = X[:, :2] + 0.1 * rng.normal(size=(300, 2))
    X[7, 0] += 4
    Y[9, 1] += 4
    d = pls_distances(fit_pls(X, Y, 2), X, Y)
    assert d.x_outliers[7]
    assert d.y_outliers[9]
    assert not d.x_outliers[9]
    assert d.x_outliers.mean() < 0.06


def test_limits_keep_99_percent_of_normal_rows():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(5000, 6))
    d = pls_distances(fit_pls(X, X[:, :2] + rng.normal(size=(5000, 2)), 3), X, X[:, :2])
    assert (d.t2 > d.t2_limit).mean() == pytest.approx(0.01, abs=0.006)
    assert (d.spe > d.spe_limit).mean() == pytest.approx(0.01, abs=0.006)
    assert spe_limit(np.zeros(4)) == 0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: systematic(10), "blocks must be 2 to 10, got 20.*There are 10 rows"),
        (lambda: systematic(10, 1), "blocks must be 2 to 10, got 1"),
        (lambda: random_blocks(5, np.random.default_rng(0)), "blocks must be 2 to 5"),
        (lambda: leave_one_out(np.zeros(5)), "different runs must be 2 to 5, got 1"),
        (lambda: systematic_repeats(np.zeros(9), 0, 3), "rows of a period must be"),
        (
            lambda: held_out(
                None, np.ones(4), np.ones(4), systematic(5, 2), np.ones(4)
            ),
            "folds are of 5 rows, the data of 4",
        ),
        (lambda: jackknife(np.zeros((1, 3)), np.zeros(3)), "groups must be 2"),
    ],
)
def test_bad_schemes_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
