"""Experiments: pure functions of their specs, and clear about what cannot be."""

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from residual.errors import InputError, UnknownNameError
from sim.engine.plant_records import PlantSpec, SampleRates, SensorNoise
from sim.engine.plant_records import ReferenceMotion as Motion
from sim.engine.plant_records import create_random_stream as make_rng
from sim.experiment import run_experiment
from sim.experiment import simulate_open_loop_windows as open_loop_windows
from sim.plant import step_tables as at
from sim.plant.closed_loop import SimulationDivergedError
from sim.plant.effect_catalogue import check_effect, list_plant_effects
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
