"""Outliers by speed class: what is odd of a standing joint is usual of a fast one."""

import numpy as np

from residual.tables.nominal_pls import NominalForm, fit_nominal_pls
from residual.tables.outliers import nominal_distances, robust_sizes, speed_classes


def test_a_joint_stands_below_two_per_cent_of_its_usual_top_speed():
    speed = np.linspace(-1, 1, 2001)[:, None]
    classes = speed_classes(speed)[:, 0]
    top = np.quantile(np.abs(speed), 0.95)
    np.testing.assert_array_equal(classes == 0, np.abs(speed[:, 0]) <= 0.02 * top)
    np.testing.assert_array_equal(classes == 2, np.abs(speed[:, 0]) > 0.3 * top)


def test_each_class_has_a_scale_of_its_own(rng):
    X = rng.uniform(-1, 1, (3000, 3))
    classes = speed_classes(X[:, 2:])
    # Nine times the noise where the joint is slow or stands.
    size = np.where(classes[:, 0] == 2, 0.1, 0.9)
    Y = (size * rng.normal(size=len(X)))[:, None]
    odd = int(np.flatnonzero(classes[:, 0] == 2)[0])
    Y[odd] = 1.0
    model = fit_nominal_pls(X, Y, NominalForm(2, 1))
    together = nominal_distances(model, X, Y)
    apart = nominal_distances(model, X, Y, classes)
    # Under one scale slow rows are outliers by the dozen; by class one in a hundred is.
    slow = classes[:, 0] != 2
    assert together.y_outliers[slow].mean() > 0.2
    assert apart.y_outliers[slow].mean() < 0.03
    assert apart.y[odd, 0] > 7
    fast = classes[:, 0] == 2
    miss = Y - model.predict(X)
    np.testing.assert_allclose(apart.y[fast], robust_sizes(miss[fast]))
