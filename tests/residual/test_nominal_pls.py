import numpy as np
import pytest

from residual.calibration.nominal_pls import NominalPlsForm, fit_nominal_pls
from residual.errors import InputError
from tests.residual.motion_blocks import motion, one_hot


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


X9 = np.random.default_rng(1).normal(size=(9, 3))


@pytest.mark.parametrize(
    ("X", "form", "message"),
    [
        (X9, NominalPlsForm(1), "levels must be 2 to .*, got 1"),
        (X9, NominalPlsForm(4, 0), "components must be 1 to 8, got 0.*9 distinct rows"),
        (X9[:, :1], NominalPlsForm(3, 1), "variables must be 2 to 64, got 1"),
        (X9 * [1, 1, 0], NominalPlsForm(3, 1), "constant over all 9 rows: x3"),
        (X9, NominalPlsForm((3, 3), 1), "of 2 variables, the rows of 3"),
        (X9, NominalPlsForm((3, 1, 3), 1), "levels must be 2 to .*, got 1"),
    ],
)
def test_bad_input_is_refused_with_bound_value_and_remedy(X, form, message):
    with pytest.raises(InputError, match=message):
        fit_nominal_pls(X, X9[:, :1], form)


def test_rows_outside_the_range_are_predicted_from_the_nearest_level(rng):
    X, Y = rng.uniform(0, 1, (100, 3)), rng.normal(size=(100, 1))
    m = fit_nominal_pls(X, Y, NominalPlsForm(3, 2))
    far, near = np.array([[9.0, 0.5, 0.5]]), np.array([[0.99, 0.5, 0.5]])
    np.testing.assert_array_equal(m.predict(far), m.predict(near))
