"""modelgap runs, sql and show: words in, answers and exit codes out."""

import io
import json
import re
import shutil
import subprocess
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.checkout import ROOT
from tests.warehouse import store_samples as samples
from warehouse.store_catalogue import quarantine_run
from warehouse.view_schema import list_views


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
    assert run(*given, "another")[1] == f"{id} was in quarantine already: bumped into\n"
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
