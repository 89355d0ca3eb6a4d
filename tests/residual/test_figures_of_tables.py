"""Importance with its doubt, and outliers by speed class."""

import numpy as np
import pytest

from residual.errors import InputError
from residual.tables.figures import (
    hotelling_t2,
    jackknife,
    nominal_distances,
    robust_sizes,
    spe_limit,
    speed_classes,
    split_pair,
    t2_limit,
)
from residual.tables.lookup import Table
from residual.tables.nominal_pls import NominalForm, fit_nominal_pls


def test_the_jack_knife_gives_the_standard_error_of_a_mean(rng):
    x = rng.normal(size=30)
    left = np.array([np.delete(x, i).mean() for i in range(30)])
    found = jackknife(left, x.mean())
    assert found.errors == pytest.approx(x.std(ddof=1) / np.sqrt(30))
    constant = jackknife(np.ones((3, 2)) * [0, 1], np.array([0.0, 1.0]))
    assert constant.significant.tolist() == [False, True]
    with pytest.raises(InputError, match="groups must be 2"):
        jackknife(np.zeros((1, 3)), np.zeros(3))


def test_limits_keep_99_percent_of_normal_rows():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(5000, 6))
    t2 = hotelling_t2(X[:, :3], X[:, :3].var(axis=0, ddof=1))
    assert (t2 > t2_limit(3, 5000)).mean() == pytest.approx(0.01, abs=0.006)
    spe = (X[:, 3:] ** 2).sum(axis=1)
    assert (spe > spe_limit(spe)).mean() == pytest.approx(0.01, abs=0.006)
    assert spe_limit(np.zeros(4)) == 0


def test_a_pair_table_splits_into_main_effects_and_what_only_both_say(rng):
    first, second = rng.integers(0, 4, 500), rng.integers(0, 3, 500)
    r, c = rng.normal(size=(4, 1)), rng.normal(size=(3, 1))
    additive = Table((0, 1), r[:, None] + c[None])
    assert np.abs(split_pair(additive, first, second)[2]).max() < 1e-9
    table = Table((0, 1), rng.normal(size=(4, 3, 2)))
    a, b, both = split_pair(table, first, second)
    np.testing.assert_allclose(a[:, None] + b[None] + both, table.values, atol=1e-9)
    rows = both[first, second]
    for level in range(4):
        np.testing.assert_allclose(rows[first == level].sum(0), 0, atol=1e-8)


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
