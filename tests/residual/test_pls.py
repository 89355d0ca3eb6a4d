import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from residual.errors import InputError
from residual.tables.components import fit_pls


def blocks(rng, n=60, k=6, j=3):
    X = rng.normal(size=(n, k)) @ rng.normal(size=(k, k)) * 10.0 ** np.arange(k) + 3
    return X, X[:, :j] / 10.0 ** np.arange(j) + rng.normal(size=(n, j))


@given(st.integers(0, 10_000), st.integers(1, 4), st.booleans())
@settings(max_examples=30, deadline=None)
def test_the_papers_equations_hold(seed, j, scale_y):
    X, Y = blocks(np.random.default_rng(seed), j=j)
    m = fit_pls(X, Y, 4, scale_y=scale_y)
    Z = (X - m.x_mean) / m.x_scale
    F = (Y - m.y_mean) / m.y_scale
    near = {"atol": 1e-8, "rtol": 1e-6}
    np.testing.assert_allclose(m.T, Z @ m.V, **near)  # 14
    TT = m.T.T @ m.T
    np.testing.assert_allclose(TT, np.diag(np.diag(TT)), atol=1e-7)
    np.testing.assert_allclose(m.P.T, np.linalg.solve(TT, m.T.T @ Z), **near)  # 16
    np.testing.assert_allclose(m.Q.T, np.linalg.solve(TT, m.T.T @ F), **near)
    np.testing.assert_allclose(m.W.T @ m.W, np.eye(4), atol=1e-8)  # 19
    G = np.linalg.inv(m.P.T @ m.W)
    np.testing.assert_allclose(m.V, m.W @ G, **near)
    np.testing.assert_allclose(G, np.triu(G), atol=1e-8)  # 20
    e, f = Z - m.T @ m.P.T, F - m.T @ m.Q.T
    np.testing.assert_allclose(m.T.T @ e, 0, atol=1e-7)  # 23
    np.testing.assert_allclose(m.T.T @ f, 0, atol=1e-7)  # 27
    largest = np.abs(m.W).argmax(axis=0)
    assert (m.W[largest, range(4)] > 0).all()
    by_scores = m.y_mean + m.transform(X) @ (m.Q.T * m.y_scale[:, None].T)
    np.testing.assert_allclose(m.predict(X), by_scores, **near)  # 21 and 24


def test_any_number_of_components_comes_from_one_fit(rng):
    X, Y = blocks(rng)
    whole = fit_pls(X, Y)
    for a in range(1, 7):
        np.testing.assert_allclose(
            whole.predict(X, a), fit_pls(X, Y, a).predict(X), atol=1e-8
        )
    np.testing.assert_allclose(whole.predict(X, 0), np.tile(Y.mean(0), (60, 1)))


def test_all_components_are_least_squares(rng):
    X, Y = blocks(rng)
    one = np.c_[np.ones(len(X)), X]
    expected = one @ np.linalg.lstsq(one, Y, rcond=None)[0]
    np.testing.assert_allclose(fit_pls(X, Y).predict(X), expected, atol=1e-7)


@pytest.mark.parametrize("scale_y", [False, True])
@pytest.mark.parametrize("j", [1, 3])
def test_it_equals_ikpls(rng, scale_y, j):
    PLS = pytest.importorskip("ikpls.numpy").PLS
    X, Y = blocks(rng, j=j)
    peer = PLS(scale_X=True, scale_Y=scale_y, ddof=1)
    peer.fit(X, Y, 5)
    ours = fit_pls(X, Y, 5, scale_y=scale_y)
    for a in (1, 3, 5):
        np.testing.assert_allclose(ours.predict(X, a), peer.predict(X, a), rtol=1e-9)


def test_weights_are_leading_singular_vectors_of_what_is_left(rng):
    X, Y = blocks(rng)
    m = fit_pls(X, Y, 4, scale_y=True)
    E, F = (X - m.x_mean) / m.x_scale, (Y - m.y_mean) / m.y_scale
    for w, t, p, q in zip(m.W.T, m.T.T, m.P.T, m.Q.T, strict=True):
        leading = np.linalg.svd(E.T @ F)[0][:, 0]
        np.testing.assert_allclose(w, leading * np.sign(leading @ w), atol=1e-9)
        np.testing.assert_allclose(t, E @ w, atol=1e-8)
        E, F = E - np.outer(t, p), F - np.outer(t, q)


def test_nothing_left_to_tell_ends_the_components_early(rng):
    X = rng.normal(size=(50, 5))
    X = np.linalg.qr(X - X.mean(0))[0]
    m = fit_pls(X, X[:, :1], 5)
    assert m.components == 1
    np.testing.assert_allclose(m.predict(X), X[:, :1], atol=1e-12)
    assert fit_pls(X, np.ones((50, 2)), 3).components == 0


def test_units_of_x_do_not_matter(rng):
    X, Y = blocks(rng)
    scaled = X * [1, 1e3, 1e-3, 5, 7, 9]
    first, second = fit_pls(X, Y, 3), fit_pls(scaled, Y, 3)
    np.testing.assert_allclose(first.predict(X), second.predict(scaled), rtol=1e-9)


X9 = np.random.default_rng(0).normal(size=(9, 3))


@pytest.mark.parametrize(
    ("X", "Y", "components", "message"),
    [
        (X9 * [1, 0, 1], X9, 1, "constant over all 9 rows: x2 = 0"),
        (X9[:, [0, 0, 1]], X9, 3, "components must be 1 to 2, got 3. .*rank of X"),
        (X9, X9, 4, "components must be 1 to 3, got 4"),
        (X9, X9, 0, "components must be 1 to 3, got 0"),
        (X9, X9[:5], 1, "X has 9 rows and Y 5"),
        (X9[:1], X9[:1], 1, "rows of X must be 2"),
        (X9, np.full((9, 1), np.inf), 1, "Y is NaN or infinite in row 0, column 1"),
        (X9[:, :0], X9, 1, "X has shape"),
    ],
)
def test_bad_input_is_refused_with_bound_value_and_remedy(X, Y, components, message):
    with pytest.raises(InputError, match=message):
        fit_pls(X, Y, components)


def test_more_components_than_fitted_are_refused(rng):
    m = fit_pls(X9, X9[:, :1] + rng.normal(size=(9, 1)), 2)
    with pytest.raises(InputError, match="components must be 0 to 2, got 3"):
        m.coefficients(3)
    with pytest.raises(InputError, match="fitted to 3: x1, x2, x3"):
        m.transform(X9[:, :2])
    with pytest.raises(InputError, match="2 names for 3 columns"):
        fit_pls(X9, X9, 1, names=("a", "b"))
