"""A twin that is simulated on the reference of a log."""

from dataclasses import replace

import numpy as np
import pytest

from residual.errors import InputError
from sim.engine.plant_records import PlantSpec, SampleRates, SensorNoise
from sim.experiment import compute_log_twin_errors as log_twin_errors
from sim.experiment import run_experiment
from tests.sim.plant_cases import ROBOT, effect, motion

pytestmark = pytest.mark.usefixtures("compiled_plant")


def test_a_log_gives_the_twin_that_ran_beside_it():
    rates = SampleRates()
    spec = PlantSpec((effect("coulomb", 2, level=9.0),), 0.0, SensorNoise(0.0, 0.0))
    run = run_experiment(ROBOT, motion("fourier", 2.0), spec, rates)
    log = replace(run.log, id="A", t=run.log.t + 7.0)
    errors = log_twin_errors(ROBOT, log)
    settled = slice(25, -25)
    for name, limit in (("e_q", 2e-5), ("e_tau", 0.5)):
        gap = errors[name][settled] - run.twin[name][settled]
        assert np.sqrt(np.mean(gap**2)) < limit
    assert np.sqrt(np.mean(run.twin["e_tau"][settled, 1] ** 2)) > 5


def test_a_log_without_a_reference_has_no_twin():
    log = run_experiment(ROBOT, motion("fourier", 0.5), PlantSpec(), SampleRates()).log
    with pytest.raises(InputError, match="A has no reference"):
        log_twin_errors(ROBOT, replace(log, id="A", q_ref=None))


def test_limits_of_the_drives_do_not_stop_a_twin_whose_body_lacks_a_balancer():
    log = run_experiment(ROBOT, motion("fourier", 2.0), PlantSpec(), SampleRates()).log
    weak = replace(ROBOT, torque_limit=0.3 * np.abs(log.tau).max(axis=0))
    errors = [log_twin_errors(robot, log)["e_q"] for robot in (ROBOT, weak)]
    np.testing.assert_array_equal(*errors)
