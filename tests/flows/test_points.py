"""What a campaign varies, as SQL has it: what lies beside the plant, and no more."""

import pytest

from flows.specs import load_campaign
from flows.steps.experiment import plan_experiments, store_campaign
from residual.errors import InputError
from warehouse.queries import query_store_rows
from warehouse.store_catalogue import read_record
from warehouse.verification import verify_store

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
    with pytest.raises(InputError, match="so it is no axis of a campaign"):
        stored(f"[grid]\n{axis}\n")


def test_sealed_is_true_or_false(stored):
    with pytest.raises(InputError, match="sealed"):
        stored(CAMPAIGN.format('[campaign]\nsealed = "no"'))
