"""Sealed truth opens on purpose, leaves a mark, and changes no verdict."""

import json
import shutil

import pytest

import modelgap as mg
from flows.cli import main
from flows.sealed_truth import show_truth
from flows.specs import load_campaign, parse_spec
from flows.steps import experiment
from flows.steps.diagnose import build_diagnose_request, diagnose_stored_runs
from flows.storage import read_verdict
from residual.diagnosis import diagnose as diagnosis
from residual.errors import InputError
from residual.verdict.document import to_json
from tests.flows import adopted_arm
from tests.flows.test_points import OPEN
from tests.once import once
from warehouse import store_files
from warehouse.queries import open_store, query_store_rows, select_run_ids
from warehouse.sql_guard import NAMED
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
    assert "--truth is for a query of your own" in capsys.readouterr().err
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
