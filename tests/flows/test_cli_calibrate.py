"""modelgap calibrate: logs and runs in; table, page, records and tables out."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import modelgap as mg
from flows.cli import main
from flows.specs import parse_spec
from flows.steps import experiment
from tests.flows.adopted_arm import unchecked
from tests.residual.identified import workplace
from warehouse.queries import open_store

KEYS = (
    "schema robot mode declared logs families rows joints variables metric table "
    "default paper_form components levels words notes warnings stored"
)


@pytest.fixture(autouse=True)
def quick(few_tables):
    with unchecked():
        yield


def run(words):
    return main(words.split())


@pytest.fixture
def place(own_folder):
    """A working directory with an arm and its logs A.csv to D.csv.

    Of four runs a choice leaves out runs, of fewer blocks of them: many more fits.
    """
    return workplace(own_folder, "ABCD", 2.4)


@pytest.fixture(scope="module")
def stored(tmp_path_factory, compiled_plant):
    store, ids = tmp_path_factory.mktemp("store"), []
    for number, kind in enumerate(("cyclic", "cyclic", *2 * ("move_stop_move",))):
        motion = {"kind": kind, "duration": 4.0, "periods": 1, "seed": number}
        data = {"seed": 3, "start": 10.0 * number, "trajectory": motion}
        data["rates"] = {"control": 500, "log": 125}
        ids.append(experiment.simulate_and_store(parse_spec(data, "SPEC.toml"), store))
    return store, ids


def test_files_give_table_page_json_and_tables_that_evaluate_alone(place, capsys):
    words = "calibrate A.csv B.csv C.csv D.csv --robot arm.urdf"
    words += " --declared rotor_inertia"
    assert run(f"{words} --report o.html --json o.json --out tables") == 0
    shown = capsys.readouterr().out
    assert "leave one run out" in shown
    assert "no family left out: the kind of motion of the logs is not known" in shown
    assert "stored" not in shown
    doc = json.loads(Path("o.json").read_text())
    assert " ".join(doc) == KEYS
    assert {row["scheme"] for row in doc["table"]} >= {"run", "random"}
    assert doc["stored"] is None
    page = Path("o.html").read_text()
    assert doc["words"][0] in page
    assert page.count('class="plot"') >= 8
    assert page.count(">Corrections over time (figure 9)</h2>") == 1
    assert doc["levels"]["levels"] == [2, 5]
    names = {"evaluate.py", "model.json", "model.npz", "tables.csv"}
    whole = mg.load_model("tables/corrected.json")
    both = {"corrected.json", f"{whole.model.robot.name}.h"}
    assert {p.name for p in Path("tables").iterdir()} == names | both
    (log,) = mg.read_logs("A.csv", whole.model.robot)
    assert whole.predict(log).shape == log.tau.shape
    np.savetxt("rows.csv", np.zeros((2, 9)), delimiter=",")
    done = subprocess.run(
        [sys.executable, "tables/evaluate.py", "tables/model.npz", "rows.csv"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert len(done.stdout.splitlines()) == 2


def test_runs_are_calibrated_as_in_the_paper_and_kept(stored, capsys):
    store, ids = stored
    words = f"calibrate {' '.join(i[:8] for i in ids)} --robot irb140 --paper"
    assert run(f"{words} --joints 1,2 --components 1 --store {store} --json -") == 0
    doc = json.loads(capsys.readouterr().out)
    assert (doc["mode"], doc["joints"]) == ("paper", [1, 2])
    assert doc["families"] == ["cyclic", "cyclic", *2 * ["move_stop_move"]]
    assert [c["block"] for c in doc["components"]][:2] == ["input", "twin error"]
    paper = next(row for row in doc["table"] if row["model"] == "paper")
    assert paper["components"] == 1
    kept = doc["stored"]
    with open_store(store) as opened:
        query = "SELECT stage FROM models WHERE model_id = '{}'"
        models = opened.sql(query.format(kept["model"])).to_pylist()
        query = (
            "SELECT stage, run_id, value FROM errors WHERE source_id = '{}' AND "
            "metric = 'rmsev_run' AND joint = 2"
        )
        errors = opened.sql(query.format(kept["validation"])).to_pylist()
        query = "SELECT kind FROM validations WHERE model_id = '{}'"
        kinds = opened.sql(query.format(kept["model"])).to_pylist()
    assert models == [{"stage": "calibrated"}]
    assert kinds == [{"kind": "calibration"}]
    stages = {"none", "ls", "plsr", "paper", "default"}
    assert {row["stage"] for row in errors} == stages
    assert {row["run_id"] for row in errors} == {None, *ids}
    pooled = [r["value"] for r in errors if r["stage"] == "ls" and not r["run_id"]]
    row = next(r for r in doc["table"] if (r["scheme"], r["model"]) == ("run", "ls"))
    assert pooled == [pytest.approx(row["rmsev"][1])]
