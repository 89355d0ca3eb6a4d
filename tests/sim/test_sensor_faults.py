"""Sensors that break during a run: what the log says, and what the arm then does."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from residual.errors import InputError
from sim.plant import step_tables as at
from sim.plant.effect_catalogue import resolve_effects
from sim.plant.sensors import simulate_torque_report
from tests.sim.plant_cases import drive, effect, motion

pytestmark = pytest.mark.usefixtures("compiled_plant")

MOVE, ONSET = motion("fourier", 2.5), 0.5
BEFORE = round(ONSET * 1000)


@pytest.fixture(scope="module")
def fine():
    return drive(reference=MOVE)


def test_a_fault_that_has_not_begun_changes_no_bit(fine):
    later = drive(
        effect("x_fault_frozen", 2, onset=9.0),
        effect("x_fault_drift", 3, onset=9.0, rate=1.0),
        reference=MOVE,
    )
    np.testing.assert_array_equal(later.rows, fine.rows)


def test_a_frozen_encoder_lets_the_arm_run_until_its_guard_stops_it(fine):
    trace = drive(effect("x_fault_frozen", 5, onset=ONSET), reference=MOVE)
    reading = trace.rows[:, at.READING, 4]
    assert (reading[BEFORE:] == reading[BEFORE - 1]).all()
    assert (trace.rows[BEFORE:, at.READING_RATE, 4] == 0.0).all()
    np.testing.assert_array_equal(trace.rows[:BEFORE], fine.rows[:BEFORE])
    # The controller pushes the joint away from where it believes it to be.
    assert np.abs(trace.rows[-1, at.Q, 4] - MOVE.q[len(trace.t) - 1, 4]) > 0.1
    assert BEFORE < len(trace.t) < len(MOVE.t)
    assert trace.phases[-1].end_step == len(trace.t) == len(trace.qdd)
    assert len(trace.rigid(4)) == len(trace.t[::4])


def test_the_arm_follows_an_encoder_that_drifts(fine):
    trace = drive(effect("x_fault_drift", 1, onset=ONSET, rate=0.05), reference=MOVE)
    since = np.maximum(MOVE.t - ONSET, 0.0)
    rows = trace.rows[:, :, 0]
    assert_allclose(rows[:, at.Q] - rows[:, at.READING], 0.05 * since, atol=1e-9)
    astray = np.abs(rows[:, at.READING] - MOVE.q[:, 0]).max()
    usual = np.abs(fine.rows[:, at.READING, 0] - MOVE.q[:, 0]).max()
    assert astray < usual + 2e-3  # it hides in the loop


def log_with(*effects):
    t, tau = np.arange(500) / 250, np.full((500, 6), 4.0)
    return simulate_torque_report(tau, t, resolve_effects(effects))


def test_a_torque_sensor_has_bias_gain_and_spikes_from_its_onset_on():
    bias = log_with(effect("x_fault_torque_bias", 2, onset=1.0, torque=-3.0))
    assert (bias[:250] == 4.0).all()
    assert (bias[250:, 1] == 1.0).all()
    assert (np.delete(bias, 1, axis=1) == 4.0).all()
    gain = log_with(effect("x_fault_torque_gain", (1, 3), onset=1.0, gain=-0.25))
    assert (gain[250:, [0, 2]] == 3.0).all()
    spikes = log_with(effect("x_fault_torque_spikes", 4, onset=0.4, size=9.0))
    rows = np.flatnonzero(spikes[:, 3] != 4.0)
    np.testing.assert_array_equal(rows, [100, 225, 350, 475])
    np.testing.assert_array_equal(spikes[rows, 3], [13.0, -5.0, 13.0, -5.0])


def test_a_torque_sensor_that_lies_does_not_move_the_arm(fine):
    faults = (
        effect("x_fault_torque_bias", 2, onset=ONSET, torque=5.0),
        effect("x_fault_torque_spikes", 3, onset=ONSET, size=5.0),
    )
    np.testing.assert_array_equal(drive(*faults, reference=MOVE).rows, fine.rows)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (effect("x_fault_drift", 1), "needs 'rate'"),
        (effect("x_fault_frozen", 9), r"joints \[9\], expected one or more of 1 to 6"),
        (effect("x_fault_torque_gain", 1, gain=-1.0), "gain is -1, expected a num"),
        (effect("x_fault_torque_spikes", 1, size=1, width=0.0), "width is 0, expected"),
    ],
)
def test_a_fault_that_cannot_be_is_refused(fault, said):
    with pytest.raises(InputError, match=said):
        drive(fault, reference=MOVE)
