"""What changed between two epochs: laws of the regression, and planted changes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from residual.changes.contrast import SQUARES, change_log_evidence, expected_evidence
from residual.changes.rows import OWN, JointRows, RowLayout

ROWS, BLOCK = 120, 12


def layout(rows=ROWS, block=BLOCK):
    second = np.arange(rows) >= rows // 2
    starts = np.arange(0, rows, block)
    return RowLayout(second, second.astype(int), starts, np.arange(len(starts)))


def drawn(seed, width=6):
    rng = np.random.default_rng(seed)
    shared = rng.normal(size=(ROWS, width))
    held = rng.uniform(0.5, 50.0, width)
    return shared, held, rng.normal(size=ROWS), rng.normal(size=(ROWS, 2))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_a_held_nuisance_is_generalised_least_squares(seed):
    """Against the closed form with the full covariance of the rows."""
    shared, held, y, columns = drawn(seed)
    joint = JointRows(shared, y, layout(), held)
    mask = layout().second
    before = np.zeros_like(columns)  # nothing of it was there
    (piece,) = joint.pieces(columns, mask, [2], before)
    size = np.sqrt((shared**2).mean(axis=0))
    precision = np.diag(held / size**2 + 1e-5 * ROWS)
    x = shared / size
    covariance = np.eye(ROWS) + x @ np.linalg.inv(precision) @ x.T
    z = columns * mask[:, None]
    assert piece.gram == pytest.approx(z.T @ np.linalg.solve(covariance, z), rel=1e-6)
    assert piece.cross == pytest.approx(z.T @ np.linalg.solve(covariance, y), rel=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_what_was_there_before_explains_no_change(seed):
    shared, held, _, columns = drawn(seed)
    joint = JointRows(shared, columns @ [3.0, -2.0], layout(), held)
    (piece,) = joint.pieces(columns, layout().second, [2])
    assert np.abs(np.linalg.solve(piece.gram, piece.cross)).max() < 20 * OWN


@settings(max_examples=25, deadline=None)
@given(st.floats(0.1, 1e4), st.floats(-5, 5), st.floats(0.01, 100.0))
def test_evidence_is_a_bayes_factor(information, theta, precision):
    """Of one coefficient, in closed form, at the likeliest of the prior's sizes."""
    known, prior = np.array([[information]]), np.array([[precision]])
    worth = float(change_log_evidence(known, known @ [theta], prior, None))
    variances = SQUARES / precision + 1 / information
    logs = [
        -0.5 * np.log(v * information) + 0.5 * theta**2 * (information - 1 / v)
        for v in variances
    ]
    assert worth == pytest.approx(max(logs) - np.log(len(SQUARES)), abs=1e-6)
    sizes = np.array([0.0, abs(theta)])
    both = expected_evidence(known, np.ones(1), prior, 20.0, sizes)
    assert both[0] <= both[1]
