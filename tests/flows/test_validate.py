"""Models by themselves on a run, and arms that are sent goals."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from flows.inputs import read_log_sets
from flows.requests import Validate
from flows.specs import parse_spec
from flows.steps import experiment, rerun, validate
from residual.drive import Drive, compute_drive_torque
from residual.errors import InputError
from residual.recording import Recording
from residual.robot.robot import load_robot
from sim.engine.plant_records import PlantSpec, ReferenceMotion, ServoDrive
from sim.plant.closed_loop import build_servo_law, follow_goal
from warehouse.queries import open_store
from warehouse.record_commit import commit_run
from warehouse.record_ids import encode_canonical_json
from warehouse.store_catalogue import open_seal, read_channels, read_record, read_run

# The nominal model by itself on a run: open loop, feed-forward, and their record.


LOAD = {"name": "payload", "joints": [6], "mass": 4.0, "com_x": 0.1}
ROBOT = load_robot("irb140")


def run(store, plant=None, **more):
    content = {"seed": 7, "trajectory": {"kind": "cyclic", "duration": 4.0}, **more}
    content |= {"plant": plant or {}, "rates": {"control": 500, "log": 250}}
    return experiment.simulate_and_store(parse_spec(content, "SPEC.toml"), store)


@pytest.fixture(scope="module")
def run_store(tmp_path_factory, compiled_plant):
    """A store with two runs, of a loaded arm and of one that is as described."""
    store = tmp_path_factory.mktemp("store")
    quiet = {"scatter": 0.0, "noise": {"torque": 0.0, "encoder": 0.0}}
    return store, run(store, {"effect": [LOAD]}, start=30.0), run(store, quiet)


@pytest.fixture(scope="module")
def loaded(run_store):
    return validate.validate(Validate(run_store[1], 0.25, run_store[0]))


def rows(store, id):
    with open_store(store) as opened:
        query = f"FROM errors WHERE source_id = '{id}' ORDER BY metric, stage, joint"
        return opened.sql(query).to_pylist()


@pytest.mark.parametrize(
    "change", [{"salt": None}, {"wind": 1.0}, {"effects": [{"name": "secret"}]}, {"noise": 3}]
)
def test_a_sealed_half_of_another_form_is_refused_and_not_told(change):
    sealed = json.loads(encode_canonical_json(PlantSpec())) | change
    if sealed["salt"] is None:
        del sealed["salt"]
    with pytest.raises(InputError, match="another form") as caught:
        experiment.parse_sealed_plant(sealed)
    assert "secret" not in str(caught.value)


def test_a_load_that_the_model_lacks_shows_in_both_validations(run_store, loaded):
    _, validation = loaded
    _, good = validate.validate(Validate(run_store[2], 0.25, run_store[0]))
    assert validation.kind == good.kind == "open_loop,feed_forward"
    # The filter of the motion and the sampling of the torque leave under a mrad.
    assert good.open_loop.max() < 1e-3
    np.testing.assert_allclose(good.nominal, good.arm, rtol=1e-6)
    assert good.nominal.max() < 1e-3
    assert (validation.open_loop[1:5] > 10 * good.open_loop[1:5]).all()
    assert (validation.nominal[1:5] > 3 * validation.arm[1:5]).all()
    assert good.notes == ()
    assert validation.notes == (
        "The run began 30 s into its session; feed-forward starts at 0 s, with cold gears.",
    )


def test_the_record_has_every_figure_in_rad(run_store, loaded):
    store, run_id, _ = run_store
    id, validation = loaded
    record = read_record(store, id)
    assert (record["robot"], record["kind"]) == ("irb140", validation.kind)
    assert (record["unit"], record["window_s"]) == ("rad", 0.25)
    errors = [r for r in rows(store, id) if r["metric"].startswith("rms")]
    assert {(r["run_id"], r["trajectory"]) for r in errors} == {(run_id, "cyclic")}
    assert [(r["metric"], r["stage"], r["joint"]) for r in errors] == [
        (metric, stage, joint)
        for metric, stage in (
            ("rms_feed_forward_q", "arm"),
            ("rms_feed_forward_q", "nominal"),
            ("rms_open_loop_q", "nominal"),
        )
        for joint in range(1, 7)
    ]
    figures = [*validation.arm, *validation.nominal, *validation.open_loop]
    assert [row["value"] for row in errors] == figures
    (nominal,) = validation.models.values()
    assert record["least_mass_matrix"] == {"nominal": nominal.least_mass}
    both = [r["value"] for r in rows(store, id) if r["metric"].startswith("percent")]
    assert both == [*nominal.acceleration, *nominal.torque]
    with open_store(store) as opened:
        parents = opened.sql(f"SELECT parent, role FROM lineage WHERE child = '{id}'")
    assert parents.to_pylist() == [{"parent": run_id, "role": "run"}]


@pytest.fixture(scope="module")
def unsealed(run_store, tmp_path_factory):
    """The store without what drives the arm: an open loop alone."""
    store = shutil.copytree(run_store[0], tmp_path_factory.mktemp("open") / "store")
    shutil.rmtree(store / "sealed")
    return store


def test_a_model_that_no_body_has_is_said_not_to_be_simulated(run_store, unsealed, monkeypatch):
    log = read_run(*run_store[:2])
    model = validate.build_nominal_model(ROBOT, [log])
    wrong = replace(model, inertial=model.inertial * 0 - 1e-3)
    both = validate.validate_model(wrong, log)
    assert both.acceleration is None
    assert both.least_mass < 0
    monkeypatch.setattr(validate, "build_nominal_model", lambda robot, logs: wrong)
    _, validation = validate.validate(Validate(run_store[1], 0.3, unsealed))
    assert "M(q) of the nominal model is not positive definite" in validation.notes[-1]


def test_without_its_sealed_half_a_run_has_the_open_loop(run_store, unsealed, loaded):
    id, validation = validate.validate(Validate(run_store[1], 0.25, unsealed))
    assert validation.kind == "open_loop"
    np.testing.assert_array_equal(validation.open_loop, loaded[1].open_loop)
    assert "no simulated arm is sealed" in validation.notes[0]
    assert len(rows(unsealed, id)) == 6 + 12  # open loop, and nominal both ways


def test_a_measured_run_has_open_loop_at_its_own_rate_and_clock(run_store, tmp_path):
    store, _, good = run_store
    log = read_run(store, good)
    rare = Recording("", "irb140", 1e3 + log.t[::2], log.q[::2], log.tau[::2])
    id = commit_run(tmp_path, rare, {"robot_hash": ROBOT.content_hash})
    _, validation = validate.validate(Validate(id[:6], 0.25, tmp_path))
    assert validation.kind == "open_loop"
    assert validation.open_loop.max() < 2e-3


def test_a_run_of_another_description_is_refused(run_store, tmp_path):
    log = replace(read_run(*run_store[:2]), id="")
    id = commit_run(tmp_path, log, {"robot_hash": "0" * 64})
    with pytest.raises(InputError, match="another description of irb140"):
        validate.validate(Validate(id, 0.25, tmp_path))


@pytest.mark.parametrize("window", [0.0, -1.0, 4.5, float("nan"), float("inf")])
def test_a_window_that_cannot_be_is_refused(run_store, window):
    with pytest.raises(InputError, match="to the length of the run, 4 s"):
        validate.validate(Validate(run_store[1], window, run_store[0]))


# An arm that is sent goals: simulated, stored, made again and read back.


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
        ({"drive": None}, r"add \[drive\] with the values"),
        ({"controller": {"model": "adopted"}}, "is sent goals, so no model can drive"),
        ({"drive": {"gain": [-1.0]}}, "gain must be a list of positive numbers"),
        ({"drive": {"gain": [1.0, 2.0]}}, "gain has 2 values, expected 6"),
    ],
)
def test_a_spec_that_no_such_arm_has_is_refused(changes, words):
    with pytest.raises(InputError, match=words):
        experiment.load_spec_robot(spec(**changes))
