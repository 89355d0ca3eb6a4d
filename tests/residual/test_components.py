"""Principal components and PLSR."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from residual.calibration.calibration_rows import fit_pca
from residual.calibration.nominal_pls import fit_pls
from residual.errors import InputError


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
