"""The background of an arm in use: drawn, in the engine, and as its drives log it."""

import numpy as np
import pytest

from residual.errors import InputError
from sim.engine.plant_records import PlantSpec, SampleRates
from sim.experiment import run_experiment
from sim.plant.plant_arm import draw_background, simulate_torque_logging
from sim.plant.typical_sizes import estimate_typical_sizes
from tests.sim.plant_cases import ROBOT, motion
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


# The background of an arm in the physics engine: books, heat and what is logged.


MOTION = motion("fourier", 3.0)


def run(**spec):
    plant = PlantSpec((), seed=5, **spec)
    return run_experiment(ROBOT, MOTION, plant, SampleRates(), 0.0)


@pytest.fixture(scope="module")
def used():
    return run(background="workshop")


def test_torques_of_a_used_arm_add_up(used):
    truth = used.truth
    parts = ("tau_rigid", "tau_rotor", "tau_friction", "tau_background")
    # Between motor and link a spring swings: its inertia is on either side of it.
    assert np.abs(truth["tau_background"]).max() > 0
    left = truth["tau_motor"] - sum(truth[name] for name in parts)
    assert np.abs(left).max() < 1e-6


def test_friction_of_a_used_arm_takes_power_and_warms_it(used):
    power = (used.truth["tau_friction"] * used.truth["motor_qd"]).sum(axis=0)
    assert np.all(power > 0)
    temperature = used.truth["temperature"]
    assert np.all(temperature[-1] > temperature[0])


def test_an_arm_that_worked_before_is_warm_and_rubs_less(used):
    warm = run(background="workshop", worked_before=2000.0)
    assert np.all(warm.truth["temperature"][0] > used.truth["temperature"][0] + 10)
    for name in ("background_level", "background_gain", "background_order_1"):
        assert np.array_equal(warm.truth[name], used.truth[name])
    fast = np.abs(used.truth["qd"]) > 0.2
    share = fast / fast.sum(axis=0)
    rubs = [(np.abs(r.truth["tau_friction"]) * share).sum(axis=0) for r in (warm, used)]
    less = 1 - rubs[0] / rubs[1]
    assert np.all((less > 0.03) & (less < 0.22))


def test_a_clean_arm_has_no_trace_of_it():
    clean = run(background="clean", worked_before=500.0)
    assert not [name for name in clean.truth if "background" in name]
