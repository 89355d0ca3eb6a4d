"""One experiment and what a campaign varies: runs, their hidden half, their points."""

import json
import pickle
from dataclasses import asdict

import numpy as np
import pytest

from flows.cli import main
from flows.specs import load_campaign, parse_spec
from flows.steps import experiment
from flows.steps.experiment import plan_experiments, store_campaign
from flows.storage import diagnosis_from_record, diagnosis_to_record
from flows.workers import run_job
from residual.errors import InputError
from residual.model.compare import FindingScatter, LogPrediction
from residual.verdict.result import Diagnosis
from sim.plant.closed_loop import SimulationDivergedError
from tests.verdict_documents import typed
from warehouse.queries import query_store_rows
from warehouse.store_catalogue import open_seal, read_channels, read_manifest, read_record, read_run
from warehouse.verification import verify_store

# One experiment: from a spec to a run in the store, with its hidden half sealed.


EFFECT = {"name": "spring", "joints": [2], "stiffness": 4.0}
SPEC = """
seed = 7
start = 30.0
[trajectory]
kind = "welding"
duration = 2.0
[[plant.effect]]
name = "spring"
joints = [2]
stiffness = 4.0
"""


def spec(**changes):
    content = {
        "seed": 7,
        "start": 30.0,
        "trajectory": {"kind": "welding", "duration": 2.0},
        "plant": {"effect": [EFFECT]},
    }
    return parse_spec(content | changes, "SPEC.toml")


def test_a_run_is_stored_once_under_the_id_that_was_known_before(tmp_path, plant):
    id = experiment.compute_run_id(spec())
    twice = [experiment.simulate_and_store(spec(), tmp_path) for _ in range(2)]
    assert twice == [id, id]
    assert len(plant["specs"]) == 1
    run = read_run(tmp_path, id)
    assert (run.robot, run.t[0], run.q.shape) == ("irb140", 30.0, (50, 6))
    assert read_channels(tmp_path, id)["e_q"].shape == (50, 6)
    manifest = read_manifest(tmp_path, id)
    assert manifest["spec"]["trajectory"]["kind"] == "welding"
    assert manifest["robot"] == "irb140"
    assert manifest["timings"] == {"reference_s": 0.1, "plant_s": 0.2}
    # It has nothing of what it hides.
    text = json.dumps(manifest)
    assert "spring" not in text
    assert str(spec().plant_spec().seed) not in text
    sealed = open_seal(tmp_path, id)
    assert sealed.spec["effects"][0]["name"] == "spring"
    assert set(sealed.truth) == {"tau_spring"}


@pytest.mark.parametrize("words", [["--dry-run"], []])
def test_the_command_says_what_it_does(tmp_path, plant, capsys, words):
    path = tmp_path / "SPEC.toml"
    path.write_text(SPEC.replace("duration = 2.0", "duration = 20.0"))
    store = ["--store", str(tmp_path / "store")]
    assert main(["experiment", str(path), *store, *words]) == 0
    motion = {"kind": "welding", "duration": 20.0}
    id = experiment.compute_run_id(spec(trajectory=motion))
    shown = capsys.readouterr().out
    assert f"{id}  to run " in shown
    assert ("stored in" in shown) == (not words)
    assert (tmp_path / "store").exists() == (not words)
    assert main(["experiment", str(path), *store]) == 0
    again = capsys.readouterr().out
    assert f"{id}  {'is there' if not words else 'to run  '}" in again


def test_a_simulation_that_diverges_stores_nothing_and_ends_with_2(tmp_path, monkeypatch, capsys):
    def diverge(spec, robot, store):
        raise SimulationDivergedError(1.25, np.zeros(6), np.full(6, 900.0), 3)

    monkeypatch.setattr(experiment, "_simulate", diverge)
    (tmp_path / "SPEC.toml").write_text(SPEC)
    store = tmp_path / "store"
    words = ["experiment", str(tmp_path / "SPEC.toml"), "--store", str(store)]
    assert main(words) == 2
    complaint = capsys.readouterr().err
    assert "1.250 s" in complaint
    assert "joint 3" in complaint
    assert not store.exists()
    # From a process of a campaign the error reaches its parent as words.
    planned = experiment.PlannedExperiment("one", spec(), "ab", False)
    with pytest.raises(InputError) as caught:
        run_job(experiment.run_planned_experiment, planned, str(store))
    assert "1.250 s" in str(pickle.loads(pickle.dumps(caught.value)))


def test_curves_come_back_from_the_store_as_they_were():
    rng = np.random.default_rng(0)
    t, tau, moving = np.arange(4.0), rng.normal(size=(4, 2)), np.ones((4, 2), bool)
    hats = {name: rng.normal(size=(4, 2)) for name in ("nominal", "augmented")}
    x = rng.normal(size=3)
    cloud = FindingScatter("spring", 2, "q2 [rad]", x, x + 1, x + 2, np.array(["a", "a", "b"]))
    before = Diagnosis(
        verdict=typed({}),
        sentences=("One.",),
        proofs=(
            LogPrediction("a", t, tau, hats, moving),
            LogPrediction("b", t, -tau, hats, ~moving),
        ),
        clouds=(cloud,),
        notes=("n",),
        residual_clouds=(
            FindingScatter("", 1, "t [s]", x, x - 1, 0 * x, np.array(["a", "b", "b"])),
        ),
    )
    record, tables = diagnosis_to_record(before)
    after = diagnosis_from_record(json.loads(json.dumps(record)), tables, before.verdict, {})
    for part in ("verdict", "sentences", "notes"):
        assert getattr(after, part) == getattr(before, part)
    for part in ("proofs", "clouds", "residual_clouds"):
        one, other = ([asdict(x) for x in getattr(d, part)] for d in (before, after))
        np.testing.assert_equal(other, one)


# What a campaign varies, as SQL has it: what lies beside the plant, and no more.


CAMPAIGN = """
{}
[trajectory]
kind = "cyclic"
duration = 4.0
[[plant.effect]]
name = "coulomb"
joints = [2]
level = 1.0
[grid]
trajectory.duration = [4.0, 5.0]
trajectory.kind = ["cyclic", "move_stop_move"]
plant.effect.level = [3.5]
plant.background = ["clean"]
plant.noise.torque = [0.25]
plant.scatter = [0.125]
plant.salt = ["pepper"]
plant.seed = [1, 2]
"""
OPEN = "[campaign]\nsealed = false"


@pytest.fixture
def stored(tmp_path):
    def make(text):
        path, store = tmp_path / "friction.toml", tmp_path / "store"
        path.write_text(text)
        planned = plan_experiments(load_campaign(path), store, "friction")
        return store, planned, store_campaign(planned, str(path), store)

    return make


def ask(store, query):
    return query_store_rows(store, query)


def test_axes_beside_the_plant_are_points_and_those_under_it_are_sealed(stored):
    store, planned, id = stored(CAMPAIGN.format(""))
    axes = {row["axis"] for row in ask(store, "SELECT axis FROM points")}
    assert axes == {"trajectory.duration", "trajectory.kind"}
    rows = ask(store, f"FROM points WHERE run_id = '{planned[0].run_id}'")
    assert [(r["value"], r["word"], r["unit"]) for r in rows] == [
        (4.0, None, "s"),
        (None, "cyclic", None),
    ]
    assert {row["campaign_id"] for row in rows} == {id}
    (row,) = ask(store, "FROM campaigns")
    assert (row["name"], row["file"], row["robot"]) == ("friction", "friction.toml", "irb140")
    record = read_record(store, id)
    label = "trajectory.duration=4 trajectory.kind=cyclic"
    assert record["labels"][planned[0].run_id] == label
    parents = ask(store, f"SELECT parent FROM lineage WHERE child = '{id}'")
    assert {r["parent"] for r in parents} == {p.run_id for p in planned}
    assert all(not each.faults for each in verify_store(store))


@pytest.mark.parametrize(("head", "opened"), [("", False), (OPEN, True)])
def test_no_byte_of_the_record_tells_what_is_sealed(stored, head, opened):
    store, _, id = stored(CAMPAIGN.format(head))
    text = str([*ask(store, "FROM points"), read_record(store, id)])
    assert ("plant.effect.level" in text, "3.5" in text) == (opened, opened)
    assert ("plant.background" in text) is opened
    for axis in ("scatter", "noise", "salt", "pepper", "plant.seed", "0.125", "0.25"):
        assert axis not in text


def test_a_campaign_that_is_open_has_values_of_its_plant_with_their_unit(stored):
    store, _, _ = stored(CAMPAIGN.format(OPEN))
    (row,) = ask(store, "SELECT DISTINCT value, unit FROM points WHERE axis = 'plant.effect.level'")
    assert row == {"value": 3.5, "unit": "N m"}


@pytest.mark.parametrize("axis", ['serial = ["A", "B"]', 'tags = [["a"], ["b"]]'])
def test_what_moves_no_id_is_no_axis(stored, axis):
    with pytest.raises(InputError, match="so a campaign cannot vary it"):
        stored(f"[grid]\n{axis}\n")


def test_sealed_is_true_or_false(stored):
    with pytest.raises(InputError, match="sealed"):
        stored(CAMPAIGN.format('[campaign]\nsealed = "no"'))
