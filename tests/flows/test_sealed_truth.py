"""Sealed truth opens on purpose; which arms are one, and what is kept apart by it."""

import json
import shutil

import pytest

import modelgap as mg
from flows.cli import main
from flows.inputs import load_run_robot
from flows.requests import Monitor
from flows.sealed_truth import show_truth
from flows.specs import load_campaign, parse_spec
from flows.steps import experiment, monitor
from flows.steps.diagnose import build_diagnose_request, diagnose_stored_runs, read_logs
from flows.steps.model_choice import adopt, choose_model, judge_adoption, resolve_adopted_model
from flows.steps.monitor import find_latest_diagnosis, group_runs_by_arm
from flows.steps.rerun import rerun_experiment
from flows.storage import read_verdict
from residual.diagnosis import diagnose as diagnosis
from residual.errors import InputError
from residual.robot.robot import load_robot
from residual.verdict.document import to_json
from tests.flows import adopted_arm
from tests.flows.test_experiment_flow import OPEN
from tests.once import once
from warehouse import store_files
from warehouse.queries import open_store, query_store_rows, select_run_ids
from warehouse.record_commit import find_last_adoption
from warehouse.sql_guard import NAMED
from warehouse.store_catalogue import read_manifest, read_record
from warehouse.store_files import ReadOnlyStoreError
from warehouse.verification import verify_store
from warehouse.view_schema import TRUTH

EFFECTS = [
    {"name": "coulomb", "joints": [2], "level": 4.0, "onset": 1.0},
    {"name": "x_wall", "joints": [1], "angle": 0.5, "stiffness": 9.0, "side": 1.0},
]


@pytest.fixture
def store(tmp_path, plant):
    for seed, effects in ((1, EFFECTS), (2, [])):
        content = {"seed": seed, "trajectory": {"kind": "cyclic", "duration": 4.0}}
        content["plant"] = {"seed": seed, "effect": effects}
        experiment.simulate_and_store(parse_spec(content, "S"), tmp_path / "store")
    return tmp_path / "store"


def test_the_view_has_a_row_for_each_parameter(store):
    with mg.open_store(store) as opened:
        rows = opened.sql("FROM truth ORDER BY effect, parameter", truth=True).rows()
    assert list(rows[0]) == [column.name for column in TRUTH]
    short = [(r["effect"], r["joints"], r["parameter"], r["value"]) for r in rows]
    assert short == [
        ("coulomb", [2], "level", 4.0),
        ("x_wall", [1], "angle", 0.5),
        ("x_wall", [1], "side", 1.0),
        ("x_wall", [1], "stiffness", 9.0),
    ]
    assert [(r["unit"], r["onset"], r["sealed"]) for r in rows[:2]] == [
        ("N m", 1.0, True),
        (None, 0.0, True),
    ]


def test_a_run_whose_campaign_shows_its_plant_is_not_sealed(tmp_path, plant):
    path, store = tmp_path / "C.toml", tmp_path / "store"
    effect = '[[plant.effect]]\nname = "coulomb"\njoints = [2]\n'
    motion = '[trajectory]\nkind = "cyclic"\nduration = 4.0\n'
    path.write_text(f"{OPEN}\n{motion}{effect}[grid]\nplant.effect.level = [4.0]\n")
    planned = experiment.plan_experiments(load_campaign(path), store, "C")
    experiment.store_campaign(planned, str(path), store)
    experiment.simulate_and_store(planned[0].spec, store, "C")
    with mg.open_store(store) as opened:
        (row,) = opened.sql("FROM truth", truth=True).rows()
    assert (row["value"], row["sealed"]) == (4.0, False)


def test_only_that_one_query_has_the_view_and_every_seal_keeps_a_mark(store, capsys):
    words = ["sql", "FROM truth", "--store", str(store)]
    assert main(words) == 2
    marks = "SELECT opened FROM runs"
    assert [r["opened"] for r in query_store_rows(store, marks)] == [False, False]
    assert main([*words, "--truth", "--format", "csv"]) == 0
    assert "coulomb" in capsys.readouterr().out
    assert [r["opened"] for r in query_store_rows(store, marks)] == [True, True]
    for path in (store / "opened").iterdir():
        assert path.name == f"run_id={json.loads(path.read_text())['run_id']}.json"
    assert all(not each.faults for each in verify_store(store))
    first = {path.name: path.read_bytes() for path in (store / "opened").iterdir()}
    with mg.open_store(store) as opened:
        assert len(opened.sql("FROM truth", truth=True)) == 4
        with pytest.raises(InputError, match="truth"):
            opened.sql("FROM truth")
    again = {path.name: path.read_bytes() for path in (store / "opened").iterdir()}
    assert again == first
    with pytest.raises(InputError, match="truth"):
        select_run_ids(store, "run_id IN (SELECT run_id FROM truth)")


def test_no_ready_query_has_the_view(store, capsys):
    assert not [name for name, (_, query) in NAMED.items() if "truth" in query.lower()]
    words = ["sql", "--named", "findings", "--truth", "--store", str(store)]
    assert main(words) == 2
    assert "--truth needs a query as text" in capsys.readouterr().err
    assert not (store / "opened").exists()


def test_the_seal_stays_shut_where_no_mark_can_be_left(store, monkeypatch):
    def refuse(*_):
        raise ReadOnlyStoreError("The store is read-only here.")

    monkeypatch.setattr(store_files, "create_staging_folder", refuse)
    with open_store(store) as opened:
        with pytest.raises(InputError, match="read-only here"):
            show_truth(opened)
        with pytest.raises(InputError, match="truth"):
            opened.sql("FROM truth")


def test_a_seal_that_was_changed_is_refused_and_one_that_is_gone_left_out(store):
    first, second = sorted((store / "sealed").iterdir())
    shutil.rmtree(first)
    (second / "spec.json").write_text("{}")
    with mg.open_store(store) as opened:
        with pytest.raises(InputError, match="damaged"):
            opened.sql("FROM truth", truth=True)
        shutil.rmtree(second)
        assert len(opened.sql("FROM truth", truth=True)) == 0


def verdict(store, ids):
    fit, held_out = ids
    request = build_diagnose_request({"fit": fit, "held_out": held_out}, store)
    with adopted_arm.unchecked():
        id = diagnose_stored_runs(request)[0]
    return json.dumps(to_json(read_verdict(store, id))).encode()


def test_a_verdict_is_the_same_byte_for_byte_whatever_is_known_of_its_runs(
    tmp_path, compiled_plant, monkeypatch
):
    """Without seals, campaigns and marks; with other tags and points; once opened.

    A question to plant or method that differs in anything is answered anew.
    """
    for module, name in ((diagnosis, "diagnose"), (experiment, "run_experiment")):
        monkeypatch.setattr(module, name, once(getattr(module, name)))
    stores = [tmp_path / name for name in ("plain", "known", "bare")]
    runs = []
    for number, store in enumerate(stores):
        contents = [
            adopted_arm.spec(kind, 1, i) | {"tags": [f"cell={number}"]}
            for i, kind in enumerate(("cyclic", "move_stop_move"))
        ]
        specs = [parse_spec(content, "S") for content in contents]
        points = {"plant.effect.stiffness": 60.0 + number, "trajectory.kind": "other"}
        entries = [(f"{i}", spec, points) for i, spec in enumerate(specs)]
        planned = experiment.plan_experiments(entries, store, f"C{number}")
        if number:
            experiment.store_campaign(planned, "C.toml", store)
        ids = [experiment.simulate_and_store(spec, store, f"C{number}") for spec in specs]
        runs.append((ids[:1], ids[1:]))
    assert runs[0] == runs[1] == runs[2]
    with mg.open_store(stores[1]) as opened:
        assert len(opened.sql("FROM truth", truth=True)) == 2
    for folder in ("sealed", "campaigns"):
        shutil.rmtree(stores[2] / folder)
    verdicts = [verdict(store, ids) for store, ids in zip(stores, runs, strict=True)]
    assert verdicts[0] == verdicts[1] == verdicts[2]


# Simulated arms: which are one and which are two, and what is kept apart by it.


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
        said = [w for w in read_logs(request).warnings if "count as findings" in w]
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
