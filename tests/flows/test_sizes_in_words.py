"""Sizes as people say them: a change, a balancer, the frame of a vector, a joint."""

import numpy as np
import pytest

from residual.effects import load_effects


@pytest.mark.parametrize("angle", [-2.8, -0.4, 0.0, 1.1, 3.0])
def test_the_wave_is_largest_where_it_is_told_to_be(angle):
    """a sin q + b cos q on a grid, against its amplitude and place in words."""
    balancer, q = load_effects()["balancer"], np.linspace(-np.pi, np.pi, 7201)
    values = 4.0 * np.array([np.sin(angle), np.cos(angle)])
    wave = values[0] * np.sin(q) + values[1] * np.cos(q)
    shown = balancer.display(values)
    assert shown["amplitude"][0] == pytest.approx(wave.max(), rel=1e-6)
    there = np.deg2rad(shown["largest at"][0])
    assert np.cos(there - q[np.argmax(wave)]) == pytest.approx(1, abs=1e-6)
