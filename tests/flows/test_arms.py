"""Simulated arms: which are one and which are two, and what is kept apart by it."""

import pytest

from flows.inputs import load_run_robot
from flows.requests import Monitor
from flows.specs import parse_spec
from flows.steps import experiment, monitor
from flows.steps.diagnose import build_diagnose_request, read_logs
from flows.steps.model_choice import adopt, choose_model, judge_adoption, resolve_adopted_model
from flows.steps.monitor import find_latest_diagnosis, group_runs_by_arm
from flows.steps.rerun import rerun_experiment
from residual.errors import InputError
from residual.robot.robot import load_robot
from tests.flows import adopted_arm
from warehouse.store_catalogue import find_last_adoption, read_manifest, read_record

PLANT = {"seed": 1}


def spec(seed=0, plant=None, **more):
    motion = {"kind": "cyclic", "duration": 4.0, "seed": seed}
    content = {"seed": seed, "trajectory": motion, "plant": plant or {}, **more}
    return parse_spec(content, "SPEC.toml")


def arm(**plant):
    return experiment.name_arm(spec(plant=plant), load_robot("irb140"))


def run(store, seed=0, plant=PLANT, **more):
    return experiment.simulate_and_store(spec(seed, plant, **more), store)


@pytest.mark.parametrize(
    ("more", "same"),
    [
        ({"noise": {"torque": 0.1, "encoder": 0.0}}, True),
        ({"worked_before": 600.0}, True),
        ({"effect": [{"name": "coulomb", "joints": [2], "level": 4.0}]}, True),
        ({"seed": 2}, False),
        ({"scatter": 0.03}, False),
        ({"background": "worn"}, False),
        ({"salt": "x"}, False),
    ],
)
def test_an_arm_is_what_robot_scatter_background_seed_and_salt_make(more, same):
    assert (arm(**PLANT | more) == arm(**PLANT)) is same
    assert len(arm(**PLANT)) == 8


def test_without_a_seed_of_the_plant_or_a_serial_an_arm_has_no_number():
    assert arm() is None
    named = spec(serial="A7")
    assert experiment.name_arm(named, load_robot("irb140")) == "A7"
    with pytest.raises(InputError, match="serial"):
        spec(serial="A 7")


def test_tags_and_serial_are_in_the_manifest_and_move_no_id(tmp_path, plant):
    bare, words = spec(1, PLANT), {"serial": "A7", "tags": ["night", "cell=4"]}
    full = spec(1, PLANT, **words)
    assert experiment.compute_run_id(bare) == experiment.compute_run_id(full)
    manifest = read_manifest(tmp_path, experiment.simulate_and_store(full, tmp_path))
    assert (manifest["serial"], manifest["tags"]) == ("A7", ["cell=4", "night"])
    assert not {"serial", "tags"} & set(manifest["spec"])
    id = run(tmp_path, 2)
    again = rerun_experiment(tmp_path, id, read_manifest(tmp_path, id))
    assert again.manifest["serial"] == read_manifest(tmp_path, id)["serial"]
    none = run(tmp_path, 3, {})
    again = rerun_experiment(tmp_path, none, read_manifest(tmp_path, none))
    assert "serial" not in again.manifest


def test_runs_of_two_plants_are_not_fitted_together(tmp_path, plant):
    one, more = run(tmp_path, 1), run(tmp_path, 2)
    other = run(tmp_path, 3, {"seed": 2})
    robot = load_run_robot("irb140", (one, more), tmp_path)
    assert robot.serial == read_manifest(tmp_path, one)["serial"]
    # Its description is that of every arm of the kind: models and runs fit together.
    assert robot.content_hash == load_robot("irb140").content_hash
    with pytest.raises(InputError, match=f"Run {other} is of irb140 .*one arm"):
        load_run_robot("irb140", (one, other), tmp_path)
    assert group_runs_by_arm([one, other, more], tmp_path) == [[one, more], [other]]


def test_a_baseline_of_another_plant_or_of_none_gets_a_warning(tmp_path, plant):
    one, two = run(tmp_path, 1), run(tmp_path, 2, {"seed": 2})
    none, same = run(tmp_path, 3, {}), run(tmp_path, 4)
    for other, warned in ((two, True), (none, True), (same, False)):
        request = build_diagnose_request({"fit": [one], "baseline": [other]}, tmp_path)
        said = [w for w in read_logs(request).warnings if "findings too" in w]
        assert bool(said) is warned


@pytest.fixture(scope="module")
def other(arm_nights):
    """A run of another plant with the same name, from an unrelated campaign."""
    content = adopted_arm.spec("cyclic", 9, 0)
    content["plant"]["seed"] = 6
    return experiment.simulate_and_store(parse_spec(content, "S"), arm_nights.store)


def test_an_adopted_model_is_of_one_plant_alone(arm_nights, other):
    store = arm_nights.store
    serial = read_manifest(store, arm_nights.first[0][0])["serial"]
    assert read_record(store, arm_nights.id)["serial"] == serial
    assert judge_adoption(store, arm_nights.id).serial == serial
    # Of the second night by the model of the first, which has no number with it.
    assert read_record(store, arm_nights.again)["serial"] == serial
    adopt(arm_nights.id, note="try", force=True, store=store)
    assert find_last_adoption(store, "irb140", serial)
    assert find_last_adoption(store, "irb140") is None
    same = resolve_adopted_model(arm_nights.second[0], store)
    assert same.diagnosis == arm_nights.id
    assert resolve_adopted_model([other], store).diagnosis is None
    assert find_latest_diagnosis([other], store) is None
    by_arm = spec(plant={"seed": 5}, controller={"model": "adopted"})
    driven = experiment.resolve_controller_model(by_arm, store)
    assert driven.controller.model == arm_nights.id
    by_other = by_arm.model_copy(update={"plant": spec(plant={"seed": 6}).plant})
    driven = experiment.resolve_controller_model(by_other, store)
    assert driven.controller.model == "nominal"


def test_an_unrelated_campaign_raises_no_alarm(arm_nights, other):
    store, runs = arm_nights.store, arm_nights.first[0]
    assert "No diagnosis of this arm" in monitor.monitor_new_runs([other], store).why
    with pytest.raises(InputError, match="Give runs and a model of one arm"):
        monitor.monitor(Monitor(arm_nights.id, (other,), good=runs, store=store))
    robot = load_run_robot("irb140", [other], store)
    with pytest.raises(InputError, match="Give a model of this arm"):
        choose_model(robot, arm_nights.id, store, [other])
