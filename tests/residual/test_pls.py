"""Principal components and PLSR, of values and of levels."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from residual.calibration.calibration_rows import fit_pca
from residual.calibration.nominal_pls import (
    NominalPlsForm,
    build_levels,
    fit_nominal_pls,
    fit_pls,
    merge_equal_rows,
)
from residual.errors import InputError
from tests.residual.motion_blocks import motion, one_hot


def blocks(rng, n=60, k=6, j=3):
    X = rng.normal(size=(n, k)) @ rng.normal(size=(k, k)) * 10.0 ** np.arange(k) + 3
    return X, X[:, :j] / 10.0 ** np.arange(j) + rng.normal(size=(n, j))


def predicted(model, X, components):
    offset, slope = model.linear(components)
    return offset + X @ slope


@pytest.mark.parametrize("j", [1, 3])
def test_every_number_of_components_of_one_fit_equals_ikpls(rng, j):
    PLS = pytest.importorskip("ikpls.numpy").PLS
    X, Y = blocks(rng, j=j)
    peer = PLS(scale_X=True, scale_Y=False, ddof=1)
    peer.fit(X, Y, 5)
    ours = fit_pls(X, Y)
    for a in (1, 3, 5):
        assert_allclose(predicted(ours, X, a), peer.predict(X, a), rtol=1e-9)
    T = (X - ours.x_mean) / ours.x_scale @ ours.V
    assert_allclose(T.T @ T, np.diag((T**2).sum(axis=0)), atol=1e-8)


def test_nothing_left_to_tell_ends_the_components_early(rng):
    X = rng.normal(size=(50, 5))
    X = np.linalg.qr(X - X.mean(0))[0]
    m = fit_pls(X, X[:, :1])
    assert m.V.shape == (5, 1)
    assert_allclose(predicted(m, X, 1), X[:, :1], atol=1e-12)
    assert fit_pls(X, np.ones((50, 2))).V.shape == (5, 0)


X9 = np.random.default_rng(0).normal(size=(9, 3))


@pytest.mark.parametrize(
    ("X", "Y", "message"),
    [
        (X9 * [1, 0, 1], X9, "constant over all 9 rows: x2 = 0"),
        (X9, X9[:5], "X has 9 rows and Y 5"),
        (X9[:1], X9[:1], "rows of X must be 2"),
        (X9, np.full((9, 1), np.inf), "Y is NaN or infinite in row 0, column 1"),
        (X9[:, :0], X9, "X has shape"),
    ],
)
def test_bad_input_is_refused_with_bound_value_and_remedy(X, Y, message):
    with pytest.raises(InputError, match=message):
        fit_pls(X, Y)


def test_components_are_eigenvectors_of_the_correlations(rng):
    X = rng.normal(size=(60, 4)) @ rng.normal(size=(4, 4))
    pca, C = fit_pca(X, rng, surrogate_count=20), np.corrcoef(X.T)
    values = pca.explained * 4 / 100
    assert_allclose(values, np.linalg.eigvalsh(C)[::-1], atol=1e-10)
    assert_allclose(C @ pca.loadings, pca.loadings * values, atol=1e-10)
    assert (pca.loadings[np.abs(pca.loadings).argmax(axis=0), range(4)] > 0).all()
    names = [name for name, _ in pca.strongest(0)]
    order = np.argsort(-np.abs(pca.loadings[:, 0]))[:3]
    assert names == [f"x{i + 1}" for i in order]


def test_slow_signals_of_no_relation_have_no_component():
    rng = np.random.default_rng(3)
    t = np.arange(400) / 400
    waves = [
        sum(rng.normal() * np.sin(2 * np.pi * k * t + rng.uniform(0, 6)) for k in (1, 2))
        for _ in range(6)
    ]
    X = np.stack(waves, axis=1)
    pca = fit_pca(X, np.random.default_rng(0), surrogate_count=60)
    assert pca.real == 0
    # Of independent rows the limit is not far above an equal share.
    assert pca.limit[0] > 1.5 * 100 / 6


def test_a_common_signal_is_one_component_and_white_noise_none(rng):
    noise = rng.normal(size=(500, 5))
    common = noise + 2 * rng.normal(size=(500, 1))
    run = np.repeat([0, 1], 250)
    assert fit_pca(noise, rng, run_of_row=run, surrogate_count=60).real == 0
    assert fit_pca(common, rng, run_of_row=run, surrogate_count=60).real == 1


@pytest.mark.parametrize(
    ("X", "options", "message"),
    [
        (np.ones((9, 2)), {}, "constant over all 9 rows: x1 = 1, x2 = 1"),
        (np.full((9, 2), np.nan), {}, "NaN or infinite in row 0"),
        (np.eye(9), {"surrogate_count": 3}, "draws must be 20 to .* got 3"),
        (np.eye(9), {"run_of_row": [0] * 8 + [1]}, "rows of a run must be 4 .* got 1"),
        (np.eye(9), {"run_of_row": [0, 1]}, "run has shape"),
    ],
)
def test_bad_blocks_are_refused_with_what_to_do(rng, X, options, message):
    with pytest.raises(InputError, match=message):
        fit_pca(X, rng, **options)


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


def test_coefficients_equal_ikpls_for_every_number_of_components(rng):
    PLS = pytest.importorskip("ikpls.numpy").PLS
    X, Y, _, _ = motion(rng, runs=1, rows=600)
    m = fit_nominal_pls(X, Y, NominalPlsForm(6, 8))
    peer = PLS(scale_X=False, scale_Y=False)
    D = one_hot(m.levels.encode(X), m.levels.sizes, m.pairs)
    peer.fit(D, Y, 8)
    for a in (1, 4, 8):
        gap = np.abs(m.predict(X, a) - peer.predict(D, a)).max()
        assert gap < 1e-9 * np.abs(Y).max()
    B = np.asarray(peer.B)[7]
    assert np.abs(m.coefficients() - B).max() < 1e-9 * np.abs(B).max()
    T = m.transform(X)
    np.testing.assert_allclose(T.T @ T, np.diag((T**2).sum(axis=0)), atol=1e-6)


FEW = np.random.default_rng(1).normal(size=(9, 3))


@pytest.mark.parametrize(
    ("X", "form", "message"),
    [
        (FEW, NominalPlsForm(1), "levels must be 2 to .*, got 1"),
        (FEW, NominalPlsForm(4, 0), "components must be 1 to 8, got 0.*9 distinct rows"),
        (FEW[:, :1], NominalPlsForm(3, 1), "variables must be 2 to 64, got 1"),
        (FEW * [1, 1, 0], NominalPlsForm(3, 1), "constant over all 9 rows: x3"),
        (FEW, NominalPlsForm((3, 3), 1), "of 2 variables, the rows of 3"),
        (FEW, NominalPlsForm((3, 1, 3), 1), "levels must be 2 to .*, got 1"),
    ],
)
def test_bad_levels_are_refused_with_bound_value_and_remedy(X, form, message):
    with pytest.raises(InputError, match=message):
        fit_nominal_pls(X, FEW[:, :1], form)


def test_rows_outside_the_range_are_predicted_from_the_nearest_level(rng):
    X, Y = rng.uniform(0, 1, (100, 3)), rng.normal(size=(100, 1))
    m = fit_nominal_pls(X, Y, NominalPlsForm(3, 2))
    far, near = np.array([[9.0, 0.5, 0.5]]), np.array([[0.99, 0.5, 0.5]])
    np.testing.assert_array_equal(m.predict(far), m.predict(near))
