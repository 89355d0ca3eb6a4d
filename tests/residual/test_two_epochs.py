"""Two epochs as one design: laws of the whitened rows, and of what may be a change."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from residual.diagnosis.epochs import search_epochs
from residual.evidence.epoch_design import EpochDesign, Whitening
from residual.model.nominal import NominalModel, prepare_fit_logs, start_model
from residual.signals.track import FilterSettings
from sim.engine.plant_records import SyntheticEffect
from tests.residual.arms import arm, short_case

ROWS = 120


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 9))
def test_whitened_rows_are_generalised_least_squares(seed, width):
    """Against the closed form with the full covariance of the rows."""
    rng = np.random.default_rng(seed)
    shared, precision = rng.normal(size=(ROWS, width)), rng.uniform(0.5, 50.0, width)
    y, z = rng.normal(size=(2, ROWS))
    whiten = Whitening.of(shared, precision)
    covariance = np.eye(ROWS) + shared @ (shared / precision).T
    expected = y @ np.linalg.solve(covariance, z)
    assert whiten(y) @ whiten(z) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    degrees = np.trace(np.eye(ROWS) - np.linalg.inv(covariance))
    assert whiten.degrees == pytest.approx(degrees, rel=1e-9)
    # Rows of uneven noise: the same, of covariance diag(1 / w^2) + M L^-1 M'.
    weight = rng.uniform(0.2, 3.0, ROWS)
    whiten = Whitening.of(shared, precision, weight)
    covariance += np.diag(weight**-2.0 - 1)
    expected = y @ np.linalg.solve(covariance, z)
    assert whiten(y) @ whiten(z) == pytest.approx(expected, rel=1e-6, abs=1e-6)


@cache
def searched(level: float):
    hidden = [SyntheticEffect("coulomb", (2,), {"level": level})] if level else []
    case = short_case(arm(), *hidden, seed=64, baseline=True)
    logs = prepare_fit_logs(case.robot, [*case.baseline, *case.fit], 0, FilterSettings())
    model = start_model(logs, None)
    nominal = NominalModel(model, (None,) * len(model.terms))
    return search_epochs(logs, len(case.baseline), nominal, lambda share: None)


@pytest.mark.parametrize("name", ["spring", "viscous", "ripple", "base_tilt"])
def test_what_was_there_before_explains_no_change(name):
    """An effect of both epochs, however large, is none of the second alone."""
    epochs, _ = searched(0.0)
    raw, design, fitted = epochs.common.design, epochs.design, epochs.common.fitted
    every = epochs.search.candidates.groups
    group = next(g for g in every if g.effect.name == name)
    (both,) = raw.add([group.placed])
    theta = np.full(len(group.ids), 2.0)
    target = [
        raw.residual(j, fitted.ids, fitted.theta) + raw.torque(both, theta, j)
        for j in range(raw.dof)
    ]
    made = EpochDesign.of(
        raw, target, epochs.friction, design.whiten, design.epochs, epochs.logs.span
    )
    made.unrest = design.unrest
    (again,) = made.add([group.placed])
    found = replace(epochs.search.score, design=made).fit([again]).of(again)
    assert np.abs(found).max() < 0.05 * 2.0


def test_a_change_is_found_by_its_own_columns_and_none_where_there_is_none():
    epochs, run = searched(3.0)
    (group,) = run.named
    assert (group.effect.name, group.joints) == ("coulomb", (1,))
    assert run.fit.of(group) == pytest.approx([3.0], rel=0.1)
    assert not epochs.design.torque(group, run.fit.of(group), 0).any()
    _, unchanged = searched(0.0)
    assert unchanged.named == unchanged.curves == ()
