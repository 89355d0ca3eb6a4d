"""Experiments: pure functions of their specs, their twins, and sensors that break."""

import hashlib
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from residual.errors import InputError, UnknownNameError
from sim.engine.plant_records import PlantSpec, SampleRates, SensorNoise
from sim.engine.plant_records import ReferenceMotion as Motion
from sim.engine.plant_records import create_random_stream as make_rng
from sim.experiment import compute_log_twin_errors as log_twin_errors
from sim.experiment import run_experiment
from sim.experiment import simulate_open_loop_windows as open_loop_windows
from sim.plant import step_tables as at
from sim.plant.closed_loop import SimulationDivergedError
from sim.plant.effect_catalogue import check_effect, list_plant_effects, resolve_effects
from sim.plant.sensors import simulate_torque_report
from sim.plant.typical_sizes import draw_plant_effect
from tests.sim.plant_cases import ROBOT, drive, effect, motion

pytestmark = pytest.mark.usefixtures("compiled_plant")

MOVE = motion("fourier", 2.0)
QUIET = SensorNoise(0.0, 0.0)
STRIBECK = effect("stribeck", 3, level=3.0, velocity=0.05)
HIDDEN = (STRIBECK, effect("x_random_walk", 1, amplitude=2.0))


def digest(run):
    arrays = [run.log.t, run.log.q, run.log.tau]
    arrays += [x for part in (run.truth, run.twin) for _, x in sorted(part.items())]
    return hashlib.sha256(b"".join(a.tobytes() for a in arrays)).hexdigest()


def test_the_log_is_what_a_robot_logs():
    run = run_experiment(ROBOT, MOVE, PlantSpec(seed=1))
    assert run.log.robot == "irb140"
    np.testing.assert_allclose(np.diff(run.log.t), 1 / 250)
    np.testing.assert_array_equal(run.log.q_ref, MOVE.q[::4])
    steps = run.log.q / 1e-4
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    noise = run.log.tau - run.truth["tau_drive"]
    share = noise.std(axis=0) / [57, 157, 54, 11, 7, 7]
    np.testing.assert_allclose(share, 0.0158, rtol=0.2)


def test_same_spec_same_bits_whatever_runs_between():
    spec = PlantSpec(HIDDEN, seed=5)
    first = digest(run_experiment(ROBOT, MOVE, spec))
    run_experiment(ROBOT, motion("fourier", 0.5), PlantSpec(seed=8))
    assert digest(run_experiment(ROBOT, MOVE, spec)) == first
    code = (
        "from tests.sim.test_plant_experiment import *\n"
        "print(digest(run_experiment(ROBOT, MOVE, PlantSpec(HIDDEN, seed=5))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == first
    assert done.stderr == ""


def test_noise_differs_between_motions_and_not_with_effects():
    def noise(reference, effects=(), start=0.0):
        spec = PlantSpec(effects, seed=5)
        run = run_experiment(ROBOT, reference, spec, start=start)
        return run.log.tau - run.truth["tau_drive"]

    plain = noise(MOVE)
    np.testing.assert_allclose(noise(MOVE, HIDDEN), plain, atol=1e-12)
    assert np.abs(noise(motion("fourier", 2.0, 2)) - plain).max() > 0.1
    assert np.abs(noise(MOVE, start=30.0) - plain).max() > 0.1


def test_an_arm_as_described_is_its_twin():
    run = run_experiment(ROBOT, MOVE, PlantSpec(scatter=0.0, noise=QUIET))
    for error in run.twin.values():
        assert np.abs(error).max() < 1e-12


def test_twin_errors_show_what_is_hidden():
    spec = PlantSpec((effect("coulomb", 2, level=8.0),), scatter=0.0, noise=QUIET)
    run = run_experiment(ROBOT, motion("fourier", 5.0), spec)
    assert set(run.twin) == {"e_q", "e_qd", "e_qdd", "e_tau"}
    moving = np.abs(run.truth["qd"][:, 1]) > 0.3
    sign = np.sign(run.truth["qd"][moving, 1])
    assert (run.twin["e_tau"][moving, 1] * sign).mean() == pytest.approx(8.0, rel=0.1)


def test_a_runaway_stops_with_time_state_and_the_joint_that_ran_farthest():
    hidden = effect("spring", 2, stiffness=-5e4)
    with pytest.raises(SimulationDivergedError, match="on joint 2"):
        run_experiment(ROBOT, MOVE, PlantSpec((hidden,)))
    hidden = effect("offset", 1, 0.2, torque=1e4)
    with pytest.raises(SimulationDivergedError, match=r"diverged at 0\.\d+ s on joint 1") as caught:
        run_experiment(ROBOT, MOVE, PlantSpec((hidden,)))
    assert 0.2 < caught.value.time < 0.5
    assert caught.value.q.shape == (6,)


@pytest.mark.parametrize(
    ("hidden", "error", "words"),
    [
        (effect("stribek", 1, level=1.0), UnknownNameError, "stribeck"),
        (effect("coulomb", 2, level=-300.0), InputError, "expected -12 or more"),
        (effect("stribeck", 1, level=1.0), InputError, "needs 'velocity'"),
        (effect("coulomb", 1, levle=1.0), UnknownNameError, "'level'"),
        (effect("coulomb", 7, level=1.0), InputError, "1 to 6"),
        (effect("coulomb", (), level=1.0), InputError, "one or more"),
        (effect("coulomb", 1, level=np.nan), InputError, "finite"),
        (effect("coulomb", 1, -1.0, level=1.0), InputError, "onset"),
        (effect("payload", 3, mass=1.0), InputError, "expected \\[6\\]"),
        (effect("payload", 6, mass=-1.0), InputError, "above 0"),
        (effect("payload", 6, mass=1.0, ixx=1.0), InputError, "all of ixx"),
        (effect("delay", 2, delay=0.01), InputError, "none"),
        (effect("torque_gain", 2, gain=-1.5), InputError, "above -1"),
        (effect("coupled_friction", 5, level=1.0), InputError, "two of"),
        (effect("coupled_friction", (5, 6), level=1.0, sign=2.0), InputError, "sign"),
    ],
)
def test_what_cannot_be_is_refused_with_a_hint(hidden, error, words):
    with pytest.raises(error, match=words):
        check_effect(hidden, ROBOT)


def test_a_motor_without_inertia_and_an_impossible_tensor_are_refused():
    spec = PlantSpec((effect("rotor_inertia", 4, inertia=-0.2),))
    with pytest.raises(InputError, match="joint 4"):
        run_experiment(ROBOT, MOVE, spec)
    tensor = dict(ixx=9.0, ixy=0.0, ixz=0.0, iyy=0.1, iyz=0.0, izz=0.1)
    spec = PlantSpec((effect("payload", 6, mass=1.0, **tensor),))
    with pytest.raises(InputError, match="moments"):
        run_experiment(ROBOT, MOVE, spec)


@pytest.mark.parametrize(
    ("rates", "words"), [(SampleRates(1000, 300), "multiple"), (SampleRates(500, 250), "500 Hz")]
)
def test_rates_that_do_not_fit_are_refused(rates, words):
    with pytest.raises(InputError, match=words):
        run_experiment(ROBOT, MOVE, PlantSpec(), rates)


@pytest.mark.parametrize("name", list_plant_effects())
def test_everything_can_be_drawn(name):
    drawn = draw_plant_effect(ROBOT, make_rng(3, "hidden"), name)
    check_effect(drawn, ROBOT)
    assert drawn == draw_plant_effect(ROBOT, make_rng(3, "hidden"), name)
    assert all(type(value) is float for _, value in drawn.parameters)


def test_the_right_torque_moves_the_nominal_model_along():
    run = drive(reference=MOVE, scatter=0.0)
    rows = run.rows
    done = Motion("done", run.t, rows[:, at.Q], rows[:, at.QD], run.qdd, None)
    error = open_loop_windows(ROBOT, done, rows[:, at.DRIVE], 0.25)
    assert np.abs(error).max() < 1e-6
    wrong = open_loop_windows(ROBOT, done, 1.02 * rows[:, at.DRIVE], 0.25)
    assert np.abs(wrong).max() > 1e-4


# A twin that is simulated on the reference of a log.


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


# Sensors that break during a run: what the log says, and what the arm then does.


WATCHED, ONSET = motion("fourier", 2.5), 0.5
BEFORE = round(ONSET * 1000)


@pytest.fixture(scope="module")
def fine():
    return drive(reference=WATCHED)


def test_a_fault_that_has_not_begun_changes_no_bit(fine):
    later = drive(
        effect("x_fault_frozen", 2, onset=9.0),
        effect("x_fault_drift", 3, onset=9.0, rate=1.0),
        reference=WATCHED,
    )
    np.testing.assert_array_equal(later.rows, fine.rows)


def test_a_frozen_encoder_lets_the_arm_run_until_its_guard_stops_it(fine):
    trace = drive(effect("x_fault_frozen", 5, onset=ONSET), reference=WATCHED)
    reading = trace.rows[:, at.READING, 4]
    assert (reading[BEFORE:] == reading[BEFORE - 1]).all()
    assert (trace.rows[BEFORE:, at.READING_RATE, 4] == 0.0).all()
    np.testing.assert_array_equal(trace.rows[:BEFORE], fine.rows[:BEFORE])
    # The controller pushes the joint away from where it believes it to be.
    assert np.abs(trace.rows[-1, at.Q, 4] - WATCHED.q[len(trace.t) - 1, 4]) > 0.1
    assert BEFORE < len(trace.t) < len(WATCHED.t)
    assert trace.phases[-1].end_step == len(trace.t) == len(trace.qdd)
    assert len(trace.rigid(4)) == len(trace.t[::4])


def test_the_arm_follows_an_encoder_that_drifts(fine):
    trace = drive(effect("x_fault_drift", 1, onset=ONSET, rate=0.05), reference=WATCHED)
    since = np.maximum(WATCHED.t - ONSET, 0.0)
    rows = trace.rows[:, :, 0]
    assert_allclose(rows[:, at.Q] - rows[:, at.READING], 0.05 * since, atol=1e-9)
    astray = np.abs(rows[:, at.READING] - WATCHED.q[:, 0]).max()
    usual = np.abs(fine.rows[:, at.READING, 0] - WATCHED.q[:, 0]).max()
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
    np.testing.assert_array_equal(drive(*faults, reference=WATCHED).rows, fine.rows)


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
        drive(fault, reference=WATCHED)
