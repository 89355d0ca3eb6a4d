"""An arm that is sent goals: simulated, stored, made again and read back."""

import numpy as np
import pytest

from flows.inputs import read_log_sets
from flows.specs import parse_spec
from flows.steps import experiment, rerun
from residual.drive import Drive, compute_drive_torque
from residual.errors import InputError
from residual.robot.robot import load_robot
from sim.engine.plant_records import ReferenceMotion, ServoDrive
from sim.plant.closed_loop import build_servo_law, follow_goal
from warehouse.store_catalogue import open_seal, read_channels, read_run

GAIN = [1500.0, 2500.0, 1200.0, 200.0, 200.0, 100.0]
DRIVE = {"gain": GAIN, "limit": [300, 300, 200, 60, 60, 30]}
HIDDEN = {"damping": [60.0, 80.0, 35.0, 5.0, 5.0, 2.5], "delay": [0.03] * 6}


def spec(**changes):
    content = {
        "seed": 7,
        "trajectory": {"kind": "cyclic", "duration": 6.0, "periods": 1},
        "rates": {"control": 1000, "log": 100},
        "drive": DRIVE,
        "plant": {"drive": HIDDEN},
    }
    return parse_spec(content | changes, "SPEC.toml")


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    store = tmp_path_factory.mktemp("servo")
    return store, experiment.simulate_and_store(spec(), store)


def test_a_run_has_goals_and_the_torque_that_its_declared_drives_make_of_them(stored):
    log = read_run(*stored)
    assert log.drive == Drive(tuple(GAIN), tuple(DRIVE["limit"]))
    tau, at_limit = compute_drive_torque(log.drive, log.q_ref, log.q, log.t)
    np.testing.assert_array_equal(log.tau, tau)
    np.testing.assert_array_equal(log.masked, at_limit)
    assert 0.01 < np.abs(log.q_ref - log.q).max() < 0.5
    # What a torque sensor would have read is in the seal alone.
    real = open_seal(*stored).truth["tau_drive"]
    assert np.abs(real - tau).max() > 1.0
    assert "e_tau" not in read_channels(*stored)


def test_the_sealed_half_has_the_true_drives_and_the_run_is_made_again(stored):
    sealed = open_seal(*stored).spec["drive"]
    assert sealed == {**DRIVE, **HIDDEN, "goal_speed": []}
    store, run = stored
    assert rerun.rerun(run, store, verify=True).reproduced


def test_the_drive_of_a_map_replaces_the_one_of_a_run(stored, tmp_path):
    store, run = stored
    (tmp_path / "C.toml").write_text(f"drive = {{gain = {GAIN}, delay = {[0.03] * 6}}}")
    before, after = (
        read_log_sets(([run], [], []), load_robot("irb140"), columns, store)
        for columns in (None, str(tmp_path / "C.toml"))
    )
    assert np.abs(after.fit[0].tau - before.fit[0].tau).max() > 1.0
    assert after.fit[0].drive.delay == (0.03,) * 6
    assert before.runs
    assert not after.runs


def test_firmware_and_bus_stand_between_a_goal_and_its_torque():
    t = np.arange(0, 1, 1e-3)
    goal = np.where(t < 0.1, 0.0, 1.0)[:, None]
    asked = ReferenceMotion("step", t, goal, 0 * goal, 0 * goal, None)
    servo = ServoDrive((8.0,), (2.0,), (0.05,), (4.0,))
    walked = follow_goal(servo, asked, 10)
    expected = np.clip(4.0 * (t - 0.149), 0.0, 1.0)
    np.testing.assert_allclose(walked.q[:, 0], expected, atol=1e-9)
    law, zero = build_servo_law(servo, walked), np.zeros(1)
    assert law(0, zero, zero, zero) == 0.0
    assert law(999, zero, zero, zero) == 2.0
    assert law(999, zero + 0.9, zero, zero) == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"drive": None}, r"add \[drive\] with what the log says"),
        ({"controller": {"model": "adopted"}}, "is sent goals, so no model can drive"),
        ({"drive": {"gain": [-1.0]}}, "gain must be a list of positive numbers"),
        ({"drive": {"gain": [1.0, 2.0]}}, "gain has 2 values, expected 6"),
    ],
)
def test_a_spec_that_no_such_arm_has_is_refused(changes, words):
    with pytest.raises(InputError, match=words):
        experiment.load_spec_robot(spec(**changes))
