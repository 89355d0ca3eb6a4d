import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.model_selection import KFold, LeaveOneGroupOut

from residual.calibration.validation_scores import (
    build_contiguous_folds,
    build_label_folds,
    compute_relative_error,
    draw_random_folds,
    sum_by_fold,
)
from residual.errors import InputError


@given(st.integers(2, 60), st.integers(2, 20), st.integers(0, 99))
@settings(max_examples=40, deadline=None)
def test_every_row_is_held_out_once_in_folds_of_equal_size(rows, blocks, seed):
    if blocks > rows:
        blocks = rows
    rng = np.random.default_rng(seed)
    for folds in (
        build_contiguous_folds(rows, blocks),
        draw_random_folds(rows, rng, blocks),
    ):
        sizes = np.bincount(folds.of_row, minlength=folds.count)
        assert folds.count == len(folds.names) == blocks
        assert np.ptp(sizes) <= 1
    assert (np.diff(build_contiguous_folds(rows, blocks).of_row) >= 0).all()


def test_errors_are_relative_to_torque_pooled():
    torque = np.array([[3.0], [3], [3], [6], [6], [6]])
    power = sum_by_fold(torque**2, build_contiguous_folds(6, 2))
    np.testing.assert_allclose(power, [[27], [108]])
    pooled = compute_relative_error(np.array([54.0]), power.sum(axis=0))
    assert pooled[0] == pytest.approx(100 * np.sqrt(54 / (27 + 108)))
    assert np.isnan(compute_relative_error(np.ones(1), np.zeros(1))).all()


def test_runs_and_equal_blocks_are_those_of_scikit_learn(rng):
    labels = rng.integers(0, 5, 60)
    parts = [
        (build_label_folds(labels), LeaveOneGroupOut().split(labels, groups=labels)),
        (build_contiguous_folds(60, 12), KFold(12).split(labels)),
    ]
    for folds, split in parts:
        of_row = np.empty(60, int)
        for fold, (_, rows) in enumerate(split):
            of_row[rows] = fold
        np.testing.assert_array_equal(folds.of_row, of_row)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: build_contiguous_folds(10),
            "blocks must be 2 to 10, got 20.*There are 10 rows",
        ),
        (lambda: build_contiguous_folds(10, 1), "blocks must be 2 to 10, got 1"),
        (
            lambda: draw_random_folds(5, np.random.default_rng(0)),
            "blocks must be 2 to 5",
        ),
        (
            lambda: build_label_folds(np.zeros(5)),
            "different runs must be 2 to 5, got 1",
        ),
    ],
)
def test_bad_schemes_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
