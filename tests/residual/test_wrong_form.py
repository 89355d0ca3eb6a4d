"""A name must have its own curve: what resembles it is not it."""

import numpy as np
import pytest

from residual.diagnosis.gate import _repeated

LOGS = np.repeat(np.arange(4), 2000)


def leftover(rng, torque):
    load = rng.normal(size=len(LOGS))
    whole = torque(load) + 0.3 * np.std(torque(load)) * rng.normal(size=len(LOGS))
    drawn = (whole @ load / (load @ load)) * load
    return load, whole - drawn, np.std(drawn)


@pytest.mark.parametrize(
    ("torque", "low", "high"),
    [
        # A gain leaves nothing, a dead zone three quarters of what a gain explains.
        pytest.param(lambda x: 0.1 * x, 0.0, 0.05, id="gain"),
        pytest.param(lambda x: -np.clip(x, -0.1, 0.1), 0.5, 1.0, id="dead zone"),
        # A stop is a spring on one side only.
        pytest.param(lambda x: np.maximum(x - 0.5, 0), 0.5, 1.5, id="stop"),
        # A bundle of hoses that hardens is a spring all the same.
        pytest.param(lambda x: x + 0.03 * x**3, 0.0, 0.15, id="cubic spring"),
    ],
)
def test_what_is_left_over_its_own_variable_tells_a_name_from_its_like(
    rng, torque, low, high
):
    load, left, drawn = leftover(rng, torque)
    left = left - left.mean()
    assert low <= _repeated(load, left, LOGS) / drawn <= high


def test_noise_that_no_two_logs_share_is_no_curve(rng):
    x = rng.normal(size=len(LOGS))
    wander = rng.normal(size=4)[LOGS] * np.sin(3 * x + 7 * LOGS)
    assert _repeated(x, rng.normal(size=len(x)), LOGS) < 0.06
    assert _repeated(x, wander, LOGS) < 0.7 * np.std(wander)
