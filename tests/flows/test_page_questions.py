"""The five questions of docs/sql.md: each query of the page answers its question."""

import re
from datetime import datetime

import pytest

from flows.sealed_truth import show_truth
from tests.checkout import ROOT
from tests.warehouse import store_samples as samples
from warehouse.queries import open_store
from warehouse.record_commit import commit_record, commit_run
from warehouse.store_catalogue import SealedTruth
from warehouse.view_schema import build_view_table

ARM = {"robot": "two_link"}
LEVELS = (1.0, 2.0, 4.0)


def page() -> dict[str, str]:
    """Return the query behind each question, by the first word of its answer."""
    text = (ROOT / "docs/sql.md").read_text("utf-8")
    part = re.search(r"## Five questions\n(.*?)\n## ", text, re.S)[1]
    questions = re.findall(r"^([A-Z][^\n]*):\n\n```sql\n(.*?)```", part, re.M | re.S)
    assert len(questions) == 5
    return {title.split()[0]: query for title, query in questions}


def commit(store, seed, level, kind):
    effect = {"name": "coulomb", "joints": [2], "parameters": [["level", level]]}
    sealed = SealedTruth({"effects": [effect | {"onset": 0.0}]}, {})
    timings = {"reference_s": 0.5, "plant_s": 2.0}
    about = samples.manifest(seed, kind, serial=f"A{seed % 2}", timings=timings)
    about["recorded_at"] = f"2026-03-{seed + 1:02}T00:00:00Z"
    return commit_run(store, samples.recording(seed), about, sealed)


def validate(store, run, error):
    row = {"run_id": run, "stage": "nominal", "metric": "moving", "value": error}
    tables = {"errors": build_view_table("errors", [row | {"joint": 1}])}
    record = ARM | {"kind": "open_loop"}
    parents, took = {"run": [run]}, {"validate": 3.0}
    return commit_record(store, "validations", record, tables, parents, seconds=took)


def identify(store, run, value):
    row = {"name": "viscous 1", "joint": 1, "value": value, "unit": "N m s/rad"}
    tables = {"parameters": build_view_table("parameters", [row])}
    record = ARM | {"stage": "identified"}
    return commit_record(store, "models", record, tables, {"fit": [run]})


def diagnose(store, run, name):
    effects = [{"name": name, "order": 1, "joints": [2]}] if name else []
    record = ARM | {"verdict": "effects" if name else "none"}
    tables = {"effects": build_view_table("effects", effects)}
    return commit_record(store, "diagnoses", record, tables, {"fit": [run]})


@pytest.fixture(scope="module")
def friction_store(tmp_path_factory):
    """Runs at three levels of friction in two families, with what was made of them."""
    store = tmp_path_factory.mktemp("questions") / "store"
    points = [(level, kind) for level in LEVELS for kind in ("cyclic", "welding")]
    runs = [commit(store, i, *point) for i, point in enumerate(points)]
    rows = [
        {"run_id": run, "axis": "plant.effect.level", "value": level, "unit": "N m"}
        for run, (level, _) in zip(runs, points, strict=True)
    ]
    tables = {"points": build_view_table("points", rows)}
    record = ARM | {"name": "friction", "file": "friction.toml"}
    commit_record(store, "campaigns", record, tables, {"point": runs})
    for run, (level, kind) in zip(runs[:5], points[:5], strict=True):
        validate(store, run, 10 * level + (kind == "welding"))
    for run, value in ((runs[0], 5.0), (runs[2], 5.2), (runs[1], 7.0)):
        identify(store, run, value)
    for run, name in zip(runs[::2], (None, "payload", "coulomb"), strict=True):
        diagnose(store, run, name)
    with open_store(store) as opened:
        show_truth(opened)
        queries = page()
        yield runs, lambda word: opened.sql(queries[word]).to_pylist()


def test_error_by_friction_level_and_family(friction_store):
    rows = friction_store[1]("Error")
    assert [(r["level"], r["trajectory"], r["error"]) for r in rows] == [
        (1.0, "cyclic", 10.0),
        (1.0, "welding", 11.0),
        (2.0, "cyclic", 20.0),
        (2.0, "welding", 21.0),
        (4.0, "cyclic", 40.0),
    ]


def test_runs_that_no_validation_covers(friction_store):
    runs, ask = friction_store
    assert [row["run_id"] for row in ask("Runs")] == [runs[5]]


def test_drift_of_parameters_by_arm(friction_store):
    (row,) = friction_store[1]("Drift")
    assert (row["serial"], row["name"], row["models"]) == ("A0", "viscous 1", 2)
    days = (datetime(2026, 3, 3) - datetime(2026, 3, 1)).days
    assert row["per_day"] == pytest.approx(0.2 / days)


def test_the_level_at_which_a_verdict_first_names_its_effect(friction_store):
    (row,) = friction_store[1]("The")
    assert (row["effect"], row["joints"], row["unit"]) == ("coulomb", [2], "N m")
    assert (row["first"], row["missed"]) == (4.0, 2.0)


def test_seconds_by_step(friction_store):
    rows = {r["step"]: (r["times"], r["seconds"]) for r in friction_store[1]("Seconds")}
    assert rows == {"plant": (6, 12.0), "reference": (6, 3.0), "validate": (5, 15.0)}
