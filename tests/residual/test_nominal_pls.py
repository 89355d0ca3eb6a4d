import numpy as np
import pytest

from residual.errors import InputError
from residual.tables.crossval import leave_one_out, random_blocks, systematic
from residual.tables.figures import nominal_distances
from residual.tables.levels import equal_levels
from residual.tables.nominal_choice import nominal_errors
from residual.tables.nominal_pls import NominalForm, fit_nominal_pls
from tests.residual.motion_blocks import motion, one_hot
from tests.residual.refit import held_out


def columns(model, X):
    codes = model.levels.encode(X)
    return one_hot(codes.values, codes.sizes, model.pairs)


@pytest.mark.parametrize("scale_y", [False, True])
def test_coefficients_equal_ikpls_for_every_number_of_components(rng, scale_y):
    PLS = pytest.importorskip("ikpls.numpy").PLS
    X, Y, _, _ = motion(rng, runs=1, rows=600)
    m = fit_nominal_pls(X, Y, NominalForm(6, 8, scale_y=scale_y))
    peer = PLS(scale_X=False, scale_Y=scale_y)
    D = columns(m, X)
    peer.fit(D, Y, 8)
    for a in (1, 4, 8):
        gap = np.abs(m.predict(X, a) - peer.predict(D, a)).max()
        assert gap < 1e-9 * np.abs(Y).max()
    if not scale_y:
        B = np.asarray(peer.B)[7]
        assert np.abs(m.coefficients() - B).max() < 1e-9 * np.abs(B).max()


def test_unvisited_cells_are_counted_per_row():
    X = np.array([[0, 0, 0], [1, 1, 1], [0, 1, 1], [1, 0, 0.0]])
    m = fit_nominal_pls(X, X[:, :1], NominalForm(2, 1))
    share = m.unvisited_share(np.array([[0, 0, 0], [0, 0, 1.0]]))
    np.testing.assert_allclose(share, [0, 1 / 3])


def test_all_folds_in_one_pass_equal_one_fit_per_fold(rng):
    X, Y, torque, run = motion(rng, runs=3, rows=200)
    form = NominalForm(5, 4, scale_y=True)
    levels = equal_levels(X, 5)
    scale = Y.std(axis=0)

    def predict(X_train, Y_train, X_new):
        m = fit_nominal_pls(X_train, Y_train, NominalForm(5, 4), levels)
        return np.stack([m.predict(X_new, a) for a in range(5)])

    schemes = [leave_one_out(run), systematic(600, 7), random_blocks(600, rng, 11)]
    for folds, ours in zip(
        schemes, nominal_errors(X, Y, schemes, torque, form), strict=True
    ):
        expected = held_out(predict, X, Y / scale, folds, torque)
        np.testing.assert_allclose(ours.miss, expected.miss * scale**2, rtol=1e-9)
        np.testing.assert_allclose(ours.power, expected.power)


def test_distances_equal_those_of_the_columns(rng):
    X, Y, _, _ = motion(rng, runs=1, rows=300)
    m = fit_nominal_pls(X, Y, NominalForm(4, 3))
    D = columns(m, X) - m.x_mean
    T = D @ m.V.T
    d = nominal_distances(m, X, Y)
    np.testing.assert_allclose(d.spe, ((D - T @ m.P) ** 2).sum(1), atol=1e-8)
    np.testing.assert_allclose(d.t2, (T**2 / T.var(0, ddof=1)).sum(1), rtol=1e-6)


def test_a_fold_whose_covariance_is_used_up_adds_nothing():
    X = np.tile([[0.0, 0], [0, 1], [1, 0], [1, 1]], (24, 1))
    Y = X[:, :1]
    errors = nominal_errors(X, Y, [systematic(96, 4)], Y + 1, NominalForm(2, 3))[0]
    assert errors.pooled()[3, 0] < 1e-4
    assert fit_nominal_pls(X, Y, NominalForm(2, 3)).components == 1


X9 = np.random.default_rng(1).normal(size=(9, 3))


@pytest.mark.parametrize(
    ("X", "form", "message"),
    [
        (X9, NominalForm(1), "levels must be 2 to .*, got 1"),
        (X9, NominalForm(4, 9), "components must be 1 to 8, got 9.*9 distinct rows"),
        (
            X9[:, :2],
            NominalForm(2, 4),
            "components must be 1 to 2, got 4.*3 distinct rows",
        ),
        (X9[:, :1], NominalForm(3, 1), "variables must be 2 to 64, got 1"),
        (X9 * [1, 1, 0], NominalForm(3, 1), "constant over all 9 rows: x3"),
        (X9, NominalForm(3, 1, "even"), "spacing must be equal or quantile"),
    ],
)
def test_bad_input_is_refused_with_bound_value_and_remedy(X, form, message):
    with pytest.raises(InputError, match=message):
        fit_nominal_pls(X, X9[:, :1], form)
    with pytest.raises(InputError, match=message):
        nominal_errors(X, X9[:, :1], [systematic(9, 3)], X9[:, :1], form)


def test_rows_outside_the_range_are_predicted_from_the_nearest_level(rng):
    X, Y = rng.uniform(0, 1, (100, 3)), rng.normal(size=(100, 1))
    m = fit_nominal_pls(X, Y, NominalForm(3, 2))
    far, near = np.array([[9.0, 0.5, 0.5]]), np.array([[0.99, 0.5, 0.5]])
    np.testing.assert_array_equal(m.predict(far), m.predict(near))
    assert m.levels.outside(far).tolist() == [[True, False, False]]
