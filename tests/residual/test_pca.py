import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from residual.errors import InputError
from residual.tables.components import (
    fit_pca,
    randomise_phases,
    real_components,
    state_block,
    state_names,
)

BLOCKS = arrays(float, (12, 4), elements=st.floats(-10, 10, width=32))


@given(BLOCKS)
@settings(max_examples=40, deadline=None)
def test_components_are_orthonormal_rebuild_the_block_and_hold_all_variance(X):
    X = X + np.random.default_rng(0).normal(size=X.shape)  # never constant
    pca = fit_pca(X)
    np.testing.assert_allclose(pca.loadings.T @ pca.loadings, np.eye(4), atol=1e-10)
    rebuilt = pca.mean + pca.scale * (pca.scores @ pca.loadings.T)
    np.testing.assert_allclose(rebuilt, X, atol=1e-9)
    assert pca.explained.sum() == pytest.approx(1)
    assert (np.diff(pca.eigenvalues) <= 1e-12).all()


def test_units_do_not_matter(rng):
    X = rng.normal(size=(50, 3)) @ rng.normal(size=(3, 3))
    first, second = fit_pca(X), fit_pca(X * [1, 100, 1e-3] + 5)
    np.testing.assert_allclose(first.scores, second.scores, atol=1e-9)


def test_components_are_eigenvectors_of_the_correlations(rng):
    X = rng.normal(size=(60, 4)) @ rng.normal(size=(4, 4))
    pca, C = fit_pca(X), np.corrcoef(X.T)
    np.testing.assert_allclose(pca.eigenvalues, np.linalg.eigvalsh(C)[::-1], atol=1e-10)
    np.testing.assert_allclose(
        C @ pca.loadings, pca.loadings * pca.eigenvalues, atol=1e-10
    )
    largest = np.abs(pca.loadings).argmax(axis=0)
    assert (pca.loadings[largest, range(4)] > 0).all()


def test_what_components_leave_shrinks_to_nothing_and_loadings_have_names(rng):
    X = rng.normal(size=(40, 3))
    X[:, 2] = X[:, 0] + 0.01 * rng.normal(size=40)
    pca = fit_pca(X, ("q1", "q2", "q3"))
    Z, T, P = (X - pca.mean) / pca.scale, pca.scores, pca.loadings
    left = [np.linalg.norm(Z - T[:, :a] @ P[:, :a].T) for a in range(4)]
    assert left == sorted(left, reverse=True)
    assert left[-1] < 1e-9
    assert {name for name, _ in pca.strongest(0, 2)} == {"q1", "q3"}


def test_state_columns_are_named_in_order():
    q = np.zeros((2, 2))
    assert state_block(q, q + 1, q + 2)[0].tolist() == [0, 0, 1, 1, 2, 2]
    assert state_names((1, 2)) == ("q1", "q2", "qd1", "qd2", "qdd1", "qdd2")


@pytest.mark.parametrize("rows", [16, 17])
def test_random_phases_keep_mean_and_spectrum_of_each_variable(rng, rows):
    X = rng.normal(size=(rows, 3))
    spectrum = np.fft.rfft(X, axis=0)
    new = randomise_phases(spectrum, rows, rng)
    assert not np.allclose(new, X)
    np.testing.assert_allclose(np.abs(np.fft.rfft(new, axis=0)), np.abs(spectrum))
    np.testing.assert_allclose(new.mean(0), X.mean(0))


def test_slow_signals_of_no_relation_have_no_component_where_permutation_sees_one():
    rng = np.random.default_rng(3)
    t = np.arange(400) / 400
    waves = [
        sum(
            rng.normal() * np.sin(2 * np.pi * k * t + rng.uniform(0, 6)) for k in (1, 2)
        )
        for _ in range(6)
    ]
    X = np.stack(waves, axis=1)
    found = real_components(X, np.random.default_rng(0), draws=60)
    assert found.count == 0
    assert found.permuted > 0


def test_a_common_signal_is_one_component_and_white_noise_none(rng):
    noise = rng.normal(size=(500, 5))
    common = noise + 2 * rng.normal(size=(500, 1))
    run = np.repeat([0, 1], 250)
    assert real_components(noise, rng, run=run, draws=60).count == 0
    found = real_components(common, rng, run=run, draws=60)
    assert (found.count, found.permuted) == (1, 1)


@pytest.mark.parametrize(
    ("X", "options", "message"),
    [
        (np.ones((9, 2)), {}, "constant over all 9 rows: x1 = 1, x2 = 1"),
        (np.full((9, 2), np.nan), {}, "NaN or infinite in row 0"),
        (np.eye(9), {"draws": 3}, "draws must be 20 to .* got 3"),
        (np.eye(9), {"run": [0] * 8 + [1]}, "rows of a run must be 4 .* got 1"),
        (np.eye(9), {"run": [0, 1]}, "run has shape"),
    ],
)
def test_bad_blocks_are_refused_with_what_to_do(rng, X, options, message):
    with pytest.raises(InputError, match=message):
        real_components(X, rng, **options)
