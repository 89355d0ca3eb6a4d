"""modelgap runs, sql and show: words in, answers out; the five questions of docs/sql.md."""

import io
import json
import re
import resource
import shutil
import subprocess
from datetime import datetime
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from flows.sealed_truth import show_truth
from residual.errors import InputError
from tests.checkout import ROOT
from tests.warehouse import store_samples as samples
from warehouse.queries import open_store
from warehouse.record_commit import SealedTruth, commit_record, commit_run
from warehouse.sql_guard import limit_process_memory
from warehouse.store_catalogue import quarantine_run
from warehouse.view_schema import build_view_table, list_views


@pytest.fixture(scope="module")
def ids(tmp_path_factory):
    folder = tmp_path_factory.mktemp("memory")
    kinds = ("fourier", "welding", "fourier")
    runs = [samples.commit(folder, seed, kind) for seed, kind in enumerate(kinds)]
    quarantine_run(folder, runs[2], "gripper was loose")
    last = samples.store_verdict(folder, samples.verdict([runs[1]]), {"theta": [1]}, runs[:2])
    return {"store": str(folder), "runs": runs, "diagnosis": last}


@pytest.fixture
def run(ids, tmp_path, monkeypatch, cli):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MODELGAP_STORE", ids["store"])
    monkeypatch.setattr("sys.stdin", io.StringIO())
    return cli


def answer(run, *words):
    code, out, err = run(*words, "--format", "json")
    assert (code, err) == (0, "")
    return json.loads(out)


def test_runs_are_listed_the_latest_last(run, ids):
    rows = answer(run, "runs")
    assert [row["run_id"] for row in rows] == ids["runs"]
    assert [row["quarantined"] for row in rows] == [False, False, True]
    assert [r["run_id"] for r in answer(run, "runs", "--limit", "1")] == ids["runs"][2:]
    code, out, _ = run("runs")
    assert code == 0
    assert all(id in out for id in ids["runs"])
    assert "3 rows" in out


def test_numbers_in_csv_and_json_are_whole(run):
    query = "SELECT max(q1) AS total, sum(rows) AS rows FROM samples, runs"
    (row,) = answer(run, "sql", query)
    assert row["rows"] == 50 * 3 * 3 * 50
    code, out, _ = run("sql", query, "--format", "csv")
    assert code == 0
    assert float(out.split()[1].split(",")[0]) == row["total"]
    query = "SELECT 'inf'::DOUBLE AS a, 'nan'::DOUBLE AS b, [-'inf'::DOUBLE] AS c"
    told = {"a": "Infinity", "b": "NaN", "c": ["-Infinity"], "d": None}
    assert answer(run, "sql", f"{query}, NULL AS d") == [told]


def test_the_schema_has_every_view_and_column_with_its_unit(run):
    rows = answer(run, "sql", "--schema")
    told = [(row["view"], row["column"]) for row in rows]
    assert told == [(v, c.name) for v, columns in list_views().items() for c in columns]
    units = {(row["view"], row["column"]): row["unit"] for row in rows}
    assert units["samples", "tau6"] == "N m"
    assert units["runs", "duration_s"] == "s"
    assert all(row["about"] for row in rows)
    code, out, _ = run("sql", "--schema")
    assert code == 0
    assert "error_by_trajectory" in out


def test_a_run_is_set_aside_once_and_as_it_is(run, ids, tmp_path):
    store = tmp_path / "store"
    id = samples.commit(store, 0)
    before = {p: p.read_bytes() for p in (store / "samples").rglob("*.parquet")}
    given = ("quarantine", id[:8], "--store", str(store), "--reason")
    code, out, err = run(*given, "bumped into")
    assert (code, out, err) == (0, f"{id} in quarantine: bumped into\n", "")
    assert run(*given, "another")[1] == f"{id} already in quarantine: bumped into\n"
    marked = answer(run, "sql", "SELECT quarantined FROM runs", "--store", str(store))
    assert marked == [{"quarantined": True}]
    assert before == {p: p.read_bytes() for p in before}
    # Undone by hand, as docs/store.md says.
    (store / "quarantine" / f"run_id={id}.json").unlink()
    assert answer(run, "runs", "--store", str(store))[0]["quarantined"] is False


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["0", "--reason", " "], "needs a reason"),
        (["ffffffff", "--reason", "x"], "Nothing in"),
        (["../x", "--reason", "x"], "is not an id"),
        (["DIAGNOSIS", "--reason", "x"], "expected the id of a run"),
    ],
)
def test_only_a_run_is_set_aside_and_for_a_reason(run, ids, words, told):
    first = {"0": ids["runs"][0], "DIAGNOSIS": ids["diagnosis"]}.get(words[0], words[0])
    code, _, err = run("quarantine", first, *words[1:])
    assert code == 2
    assert told in err


def test_a_record_is_shown_by_the_beginning_of_its_id(run, ids):
    id = ids["runs"][2]
    record = answer(run, "show", id[:10])
    assert (record["kind"], record["id"]) == ("runs", id)
    assert record["folder"] == f"samples/robot=two_link/run_id={id}"
    assert record["quarantined"] == "gripper was loose"
    assert record["content"]["spec"] == samples.spec(2)
    record = answer(run, "show", ids["diagnosis"])
    assert {p["role"] for p in record["parents"]} == {"fit", "held_out", "model"}
    assert record["content"]["document"]["verdict"] == "effects"
    record = answer(run, "show", ids["runs"][0])
    assert {(c["role"]) for c in record["children"]} == {"fit"}
    code, out, _ = run("show", ids["diagnosis"][:10])
    assert code == 0
    lines = out.splitlines()
    assert len(lines) <= 60
    assert lines[0] == f"diagnosis {ids['diagnosis']} of two_link"
    assert lines[2].startswith("The model lacks a payload at the flange")
    assert re.search(r"^mass +2\.90 ± 0\.10 kg$", out, re.MULTILINE)
    assert re.search(r"^1 .*6\.0", out, re.MULTILINE)
    assert f"\nfit: {ids['runs'][0][:8]}" in out
    assert f"\nnot adopted: modelgap adopt {ids['diagnosis'][:8]}\n" in out
    assert lines[-1].endswith("--format json")


def test_what_is_shown_of_a_run_does_not_tell_what_is_hidden(run, ids):
    _, out, _ = run("show", ids["runs"][0])
    assert "stribeck" not in out
    assert "salt" not in out


def test_a_named_query_takes_a_value(run, ids):
    (model,) = answer(run, "sql", "SELECT model_id FROM models")
    words = ("sql", "--named", "runs_of_model", "--with")
    rows = answer(run, *words, f"model={model['model_id'][:8]}")
    assert {row["run_id"] for row in rows} == set(ids["runs"][:1])
    assert answer(run, *words, "model=' OR true --") == []
    made = ("--named", "made_from_run", "--with")
    below = answer(run, "sql", *made, f"run={ids['runs'][0]}")
    assert ids["diagnosis"] in {row["id"] for row in below}
    drift = answer(run, "sql", "--named", "parameter_drift", "--with", "name=payload")
    assert [(r["name"], r["value"], r["moved"]) for r in drift] == [("payload mass", 2.9, 0.0)]


def test_an_answer_goes_into_a_file_in_every_format(run, tmp_path):
    query = "SELECT run_id, duration_s FROM runs ORDER BY run_id"
    (tmp_path / "out").mkdir()
    for format in ("table", "csv", "json", "parquet"):
        path = tmp_path / "out" / format
        code, out, _ = run("sql", query, "--format", format, "--out", str(path))
        assert (code, out) == (0, f"wrote {path}: 3 rows\n")
    table = pq.read_table(tmp_path / "out" / "parquet")
    assert table.schema.names == ["run_id", "duration_s"]
    assert table.to_pylist() == json.loads((tmp_path / "out" / "json").read_text())
    assert (tmp_path / "out" / "csv").read_text().count("\n") == 4


def test_what_the_page_says_packs_a_record_with_all_that_it_needs(run, ids, tmp_path):
    page = (ROOT / "docs" / "store.md").read_text(encoding="utf-8")
    block = page.split("*To another machine.*")[1].split("```")[1]
    lines = re.findall(r"^\$ (.*)$", block.replace("3f2a", ids["diagnosis"]), re.M)
    # Our commands run in this process; the shell has what the first one answers.
    lineage, verify = (line.split("modelgap ")[1].split(" | ")[0] for line in (lines[0], lines[-1]))
    Path("lineage").write_text(run(lineage)[1])
    shutil.copytree(ids["store"], tmp_path / "store")
    script = "\n".join(("set -e", "modelgap() { cat lineage; }", *lines))
    subprocess.run(["bash", "-c", script], check=True)
    code, out, _ = run(verify)
    assert (code, "2 runs, 1 models, 1 diagnoses, 2 sealed" in out) == (0, True)


# The five questions of docs/sql.md: each query of the page answers its question.


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


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="Linux counts the memory")
def test_a_query_ends_before_the_memory_of_the_machine(run, monkeypatch):
    before = resource.getrlimit(resource.RLIMIT_AS)
    monkeypatch.setattr("warehouse.sql_guard.read_machine_memory", lambda: 700_000_000)
    # 24 GB that DuckDB does not count.
    code, _, err = run("sql", "SELECT unnest(range(3000000000))")
    assert code == 2
    assert "half of this machine's memory. Ask for less" in err
    with pytest.raises(InputError, match="Ask for less: aggregate"), limit_process_memory():
        bytearray(10**9)  # as an answer is written
    assert resource.getrlimit(resource.RLIMIT_AS) == before
