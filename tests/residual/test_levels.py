from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from residual.calibration.nominal_pls import build_levels, merge_equal_rows
from residual.errors import InputError

COLUMNS = arrays(
    float, st.integers(3, 40), elements=st.floats(-5, 5, width=16), fill=st.nothing()
).filter(lambda x: np.ptp(x) > 0.1)

equal_levels = partial(build_levels, equally_wide=True)


@given(COLUMNS, st.integers(2, 30), st.sampled_from([equal_levels, build_levels]))
@settings(max_examples=60, deadline=None)
def test_levels_follow_the_order_of_values_and_stay_within_their_number(x, k, make):
    levels = make(x, k)
    codes = levels.encode(x)
    assert codes.max() < levels.sizes[0] <= k
    order = np.argsort(x, kind="stable")
    assert (np.diff(codes[order, 0].astype(int)) >= 0).all()


@pytest.mark.parametrize("levels", [3, 300])
def test_merged_rows_keep_every_sum(rng, levels):
    X = rng.integers(0, 2, size=(200, 9)) + 0.1 * rng.integers(0, 2, size=(200, 9))
    Y = rng.normal(size=(200, 2))
    made = equal_levels(X, levels)
    codes = made.encode(X)
    cells = merge_equal_rows(codes, made.sizes)
    assert cells.count.sum() == 200
    assert len(cells.count) == len(np.unique(codes, axis=0))
    np.testing.assert_array_equal(cells.codes[cells.of_row], codes)
    np.testing.assert_allclose(cells.sums(Y).sum(0), Y.sum(0))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: equal_levels(np.arange(5.0), 1), "levels must be 2 to .*, got 1"),
        (lambda: build_levels(np.arange(5.0), 0), "levels must be 2 to .*, got 0"),
        (lambda: equal_levels(np.arange(5.0), 2.5), "levels must be .* got 2.5"),
        (lambda: equal_levels(np.ones(5), 3), "constant over all 5 rows: x1 = 1"),
        (lambda: equal_levels(np.array([1, np.nan]), 3), "X is NaN or infinite in row 1"),
        (
            lambda: equal_levels(np.arange(5.0), 3).encode(np.ones((2, 2))),
            "X has 2 columns, the levels are of 1",
        ),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
