"""modelgap identify: words in; tables, files and messages out."""

import json
import re
from contextlib import chdir
from pathlib import Path

import duckdb
import pytest

from flows.cli import main
from residual.errors import InputError
from residual.robot.robot import load_robot
from tests.flows.adopted_arm import unchecked
from tests.residual.identified import workplace
from warehouse.queries import query_store_rows, select_run_ids
from warehouse.store_catalogue import read_record

KEYS = (
    "schema robot declared method prior logs held_out same_run condition noise rows "
    "independent_rows outliers parameters error acceleration_error "
    "least_mass_matrix consistent warnings"
)


def run(words):
    return main(words.split())


@pytest.fixture
def place(own_folder):
    with unchecked():
        yield workplace(own_folder, "ABC", 8.0)


def test_parameters_and_errors_are_shown_and_written(place, capsys):
    words = "identify A.csv B.csv --robot arm.urdf --holdout C.csv --json o.json"
    assert run(f"{words} --out new") == 0
    shown = capsys.readouterr().out
    assert "fit: A B | baseline: – | held out: C" in shown
    assert "J1: inertia Izz of link 1" in shown
    assert "viscous coefficient of joint 2" in shown
    assert "wls fit of " in shown
    assert "least eigenvalue of M(q)" in shown
    document = json.loads(Path("o.json").read_text())
    assert " ".join(document) == KEYS
    errors = document["error"]["filtered"]
    assert errors["identified"]["overall"] < 0.3 * errors["nominal"]["overall"]
    by_name = {p["name"]: p for p in document["parameters"]}
    friction = by_name["coulomb level of joint 1"]
    assert abs(friction["value"] - 4.0) < 4 * friction["sd"] + 0.1
    assert (friction["unit"], friction["status"]) == ("N m", "fitted")
    assert document["consistent"] is None
    assert load_robot("new").name == "small_arm"
    assert "wrote new" in shown


def test_consistent_parameters_stand_beside_the_free_ones(place, capsys):
    words = "identify A.csv --robot arm.urdf --holdout C.csv --consistent --json o.json"
    assert run(f"{words} --prior 0.5") == 0
    document = json.loads(Path("o.json").read_text())
    assert min(document["consistent"]["masses"]) > 0
    assert min(document["consistent"]["least_eigenvalue"]) > 0
    assert document["least_mass_matrix"]["consistent"] > 0
    filtered = document["error"]["filtered"]
    assert filtered.keys() == {"nominal", "identified", "consistent"}
    assert "positive definite" in capsys.readouterr().out


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    """A folder with a store of three runs; these by the word for their motion."""
    folder = workplace(tmp_path_factory.mktemp("runs"), "ABC", 4.0)
    with chdir(folder), unchecked():
        for log, motion in zip("ABC", ("fourier", "fourier", "welding"), strict=True):
            words = f"import {log}.csv --robot arm.urdf --store s --tag lot=1"
            assert run(f"{words} --trajectory {motion}") == 0
    rows = query_store_rows(folder / "s", "FROM runs")
    return folder, {row["run_id"]: row["trajectory"] for row in rows}


@pytest.fixture
def runs(imported, monkeypatch):
    monkeypatch.chdir(imported[0])
    with unchecked():
        yield imported[1]


def test_runs_chosen_by_a_condition_are_kept_and_rerun_by_their_ids(runs):
    chosen = ["--where", "'lot=1' IN tags AND trajectory = 'fourier' -- two"]
    proof = ["--holdout-where", "trajectory IN (SELECT 'welding')"]
    usual = ["--robot", "arm.urdf", "--store", "s"]
    assert main(["identify", *chosen, *proof, *usual]) == 0
    (model,) = query_store_rows(Path("s"), "FROM models")
    record = read_record(Path("s"), model["model_id"])["request"]
    assert {runs[id] for id in record["logs"]} == {"fourier"}
    assert len(record["logs"]) == 2
    assert [runs[id] for id in record["held_out"]] == ["welding"]
    assert not {"where", "held_out_where"} & set(record)
    assert main(["rerun", model["model_id"], "--store", "s"]) == 0
    assert main(["diagnose", *chosen, *proof, *usual, "--json", "v.json"]) == 0
    assert json.loads(Path("v.json").read_text())["error"]["same_run"] is False
    # The proof has what the command printed of its logs, and so has its rerun.
    (proof,) = query_store_rows(Path("s"), "FROM validations WHERE kind = 'held_out'")
    assert read_record(Path("s"), proof["validation_id"])["notes"][0].startswith("fit:")
    assert main(["rerun", proof["validation_id"], "--store", "s"]) == 0


def test_an_arm_with_a_serial_number_is_identified_again_to_the_last_bit(place):
    # The order of its declared effects is in the sums.
    log = Path(__file__).parents[2] / "examples/hidden/fit_1.csv"
    assert run(f"import {log}@0:6 --robot irb140 --serial B-18 --store s") == 0
    assert run("identify --where true --robot irb140 --store s") == 0
    (model,) = query_store_rows(Path("s"), "FROM models")
    assert model["serial"] == "B-18"
    assert run(f"rerun {model['model_id']} --store s") == 0


CONDITIONS = (
    ("", "not one condition"),
    ("true) OR (false", "not one condition"),
    ("true; DROP TABLE runs", "not one condition"),
    ("true UNION SELECT run_id FROM runs", "not one condition"),
    ("true, false", "not one condition"),
    ("nothing = 1", "nothing"),
    ("run_id IN (SELECT content FROM read_text('/etc/passwd'))", "read_text"),
)


def test_a_condition_is_one_and_reads_only_the_store(runs):
    for condition, why in CONDITIONS:
        with pytest.raises(InputError, match=why):
            select_run_ids(Path("s"), condition)


def test_the_query_of_the_page_reads_the_files_by_plain_duckdb(runs):
    page = Path(__file__).parents[2] / "docs" / "sql.md"
    *_, query = re.findall(r"```sql\n(.*?)```", page.read_text(), re.S)
    rows = duckdb.sql(query.replace("STORE", "s")).fetchall()
    assert {row[0] for row in rows} == set(runs)
    assert all(samples == 1000 and peak > 0 for _, samples, peak in rows)
