"""The background of an arm in use: what is drawn for it, and what its drives log."""

import numpy as np
import pytest

from residual.errors import InputError
from sim.plant.plant_arm import draw_background, simulate_torque_logging
from sim.plant.typical_sizes import estimate_typical_sizes
from tests.sim.plant_cases import ROBOT
from tests.synthetic.logs import LogPlan, make
from tests.synthetic.quasi_static import Plant

SCALE = {"workshop": 1.0, "worn": 2.0}
COULOMB = np.full(6, 4.0)
SPAN = estimate_typical_sizes(ROBOT).torque
# What of it a joint has at least and at most; of the first four twice where it is worn.
RANGES = {
    "level": (0.15 * COULOMB, 0.5 * COULOMB),
    "press": (0.01, 0.05),
    "twist": (3e-4, 1.5e-3),
    "peak": (0.003 * SPAN, 0.012 * SPAN),
    "speed": (0.03, 0.12),
    "housing": (100.0, 400.0),
    "oil": (25.0, 100.0),
}


@pytest.mark.parametrize("word", SCALE)
@pytest.mark.parametrize("seed", range(1, 5))
def test_every_joint_has_a_part_of_its_own_size(seed, word):
    background, scale = draw_background(ROBOT, word, seed, COULOMB), SCALE[word]
    turn = np.linspace(-np.pi, np.pi, 20001)[:, None, None]
    amplitude, order, phase = np.moveaxis(background.waves, 2, 0)
    wave = (amplitude * np.sin(order * turn + phase)).sum(axis=1)
    values = background.drawn | {"peak": np.abs(wave).max(axis=0)}
    for i, (name, (low, high)) in enumerate(RANGES.items()):
        times = scale if i < 4 else 1.0
        assert np.all(values[name] >= times * low * (1 - 1e-3)), name
        assert np.all(values[name] <= times * high * (1 + 1e-3)), name
        assert np.ptp(values[name]) > 0, name  # drawn joint by joint
    for name, most in (("gain", 0.04), ("lean", 0.08)):  # of either sign
        assert 0.1 * scale * most < np.abs(values[name]).max() <= scale * most
    warm = values["growth"] / (1 + values["growth"])  # less friction by that share
    assert np.all((warm >= scale * 0.05) & (warm <= scale * 0.2))


@pytest.mark.parametrize(("word", "corner"), [("workshop", 40.0), ("worn", 20.0)])
def test_torque_is_logged_late_and_in_steps(word, corner):
    background = draw_background(ROBOT, word, 1, COULOMB)
    t = np.arange(20000) / 5000.0
    wave = np.sin(2 * np.pi * corner * t)[:, None] * background.span
    log = simulate_torque_logging(background, wave, 5000.0)
    ratio = log[10000:].std(axis=0) / wave[10000:].std(axis=0)
    np.testing.assert_allclose(ratio, 2**-0.5, rtol=0.03)  # 3 dB at the corner
    steps = log / (SCALE[word] * 1e-3 * background.span)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


def test_a_clean_arm_is_what_it_was():
    """Figures of the version before there was a background."""
    plan = (LogPlan("fit_1", "fit", "cyclic", 6.0),)
    (log,) = make(Plant(ROBOT, (), 2, "clean"), plan, 2)
    before = (44.976943418502714, 59.734060523380585, 58.5828019034465, 97.565831253829)
    np.testing.assert_allclose(log.tau[100::400, 1], before, rtol=1e-12)


def test_an_unknown_word_is_refused_with_what_was_expected():
    with pytest.raises(InputError, match=r"'dusty'.*clean, workshop, worn"):
        draw_background(ROBOT, "dusty", 1, np.ones(6))
