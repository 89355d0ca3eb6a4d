"""Thinned curves and clouds must not change what the reader concludes."""

import numpy as np
import pytest

from flows.report.figures import look


@pytest.mark.parametrize("count", [1, 2, 899, 900, 901, 4000, 12345])
def test_envelope_keeps_ends_and_every_single_peak(count: int) -> None:
    t = np.arange(count) * 0.004
    for spike in {0, count // 3, count - 1}:
        y = np.zeros(count)
        y[spike] = 5.0
        ts, ys = look.envelope(t, y)
        assert ys.max() == 5.0
        assert (ts[0], ts[-1]) == (t[0], t[-1])
        assert np.all(np.diff(ts) > 0)
        assert len(ts) <= 903


def test_spans_cover_exactly_the_flagged_time() -> None:
    flags = np.array([True, False, True, True, False, True])
    assert look.spans(np.arange(6.0), flags) == [(0.0, 1.0), (2.0, 2.0), (5.0, 0.0)]


def test_bins_part_a_friction_step_at_zero() -> None:
    x = np.linspace(-0.7, 1.1, 2000)
    y = np.sign(x)
    at = look.edges(x, y)
    assert 0.0 in at
    assert np.all(np.diff(at) > 0)
    median = look.medians(x, y, at).median
    assert set(np.unique(median[np.isfinite(median)])) == {-1.0, 1.0}
