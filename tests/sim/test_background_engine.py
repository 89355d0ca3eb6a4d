"""The background of an arm in the physics engine: books, heat and what is logged."""

import numpy as np
import pytest

from sim.engine.plant_records import PlantSpec, SampleRates
from sim.experiment import run_experiment
from tests.sim.plant_cases import ROBOT, motion

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
