"""The door: what `import modelgap as mg` gives, and what it does not load."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import modelgap as mg
from flows.api.results import Diagnosis
from residual.errors import InputError
from residual.verdict.document import from_json
from residual.verdict.result import (
    ErrorTables,
    Evidence,
    Finding,
    Frames,
    Parameter,
    Place,
    Unexplained,
    Verdict,
)
from tests.residual.test_model_record import model_of
from warehouse.record_commit import commit_run

ROOT = Path(__file__).parents[1]
HEAVY = ("numpy", "pinocchio", "prefect", "pybullet", "duckdb", "rich")


CODE = f"""
import sys
import modelgap as mg
print(sorted(set({HEAVY}) & set(sys.modules)))
mg.diagnose, mg.identify, mg.calibrate, mg.compare, mg.read_logs
print(sorted({{'prefect', 'pybullet', 'duckdb', 'cvxpy'}} & set(sys.modules)))
"""


def test_importing_it_loads_nothing_heavy_and_a_diagnosis_neither_engine_nor_database():
    done = subprocess.run([sys.executable, "-c", CODE], cwd=ROOT, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("[]\n[]\n", "")


@pytest.mark.parametrize("name", mg.__all__)
def test_every_name_is_there(name):
    assert getattr(mg, name).__doc__
    assert name in dir(mg)


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'modelgap' has no attribute 'diagnoze'"):
        _ = mg.diagnoze


def test_a_store_answers_with_finished_tables(tmp_path):
    rng = np.random.default_rng(1)
    log = mg.Recording("", "irb140", np.arange(50) / 100, *rng.normal(size=(2, 50, 6)))
    commit_run(tmp_path, log, {"spec": {"robot": "irb140"}})
    with mg.open_store(tmp_path) as store:
        assert repr(store) == f"Store({tmp_path.name}: 1 runs)"
        runs = store.sql("SELECT rows FROM runs WHERE robot = $robot", robot="irb140")
        assert "findings" in store.named
        assert len(store.sql("findings")) == 0
        with pytest.raises(InputError, match="Only one SELECT"):
            store.sql("DROP VIEW runs")
    assert runs.rows() == [{"rows": 50}]


def _diagnosis() -> Diagnosis:
    both = dict(nominal=(31.5,), identified=(31.3,), augmented=(2.0,), plsr=None)
    overall = {name: value and value[0] for name, value in both.items()}
    error = ErrorTables(
        "%", 8.0, ("<script>",), False, both, both, both, overall, overall, overall, ()
    )
    evidence = Evidence(310.0, "fit", "confirmed", 0.9, None)
    mass = {"mass": Parameter(3.96, 0.35, "kg")}
    spring = (Place("spring", (1,)),)
    effect = Finding("payload", (1,), 0.97, 1, spring, mass, evidence=evidence)
    left = Unexplained((), 0.04, 0.03, (), None, (0.04,), "autocorrelation")
    rest = left, error, 0.03, None, ("<&>",)
    frames = Frames(("one",), "flange")
    return Diagnosis(Verdict("arm", (), "effects", (effect,), (), *rest, frames=frames))


def test_the_findings_are_a_table_and_its_models_have_names():
    row = {"effect": "payload", "joints": [1], "probability": 0.97}
    row |= {"parameter": "mass", "value": 3.96, "std": 0.35, "unit": "kg"}
    assert _diagnosis().to_frame().rows() == [row]
    diagnosis = _diagnosis()
    empty = Diagnosis(replace(diagnosis.verdict, effects=()))
    assert empty.to_frame().columns == list(row)
    models = {"nominal": 1, "identified": 2, "augmented": 3}
    named = Diagnosis(diagnosis.verdict, models)
    assert (named.nominal, named.identified, named.augmented) == (1, 2, 3)


def test_a_model_in_pinocchio_weighs_what_the_model_does():
    model = model_of([])
    own, zero = model.pin(), np.zeros((1, model.robot.dof))
    q = zero + 0.3
    weight = pin.rnea(own, own.createData(), q[0], zero[0], zero[0])
    np.testing.assert_allclose(weight, model.torque(q, zero, zero)[0], atol=1e-10)


def test_a_diagnosis_is_kept_as_a_page_and_as_json(tmp_path):
    diagnosis = _diagnosis()
    diagnosis.save_report(tmp_path / "out.html")
    assert "&lt;script&gt;" in (tmp_path / "out.html").read_text(encoding="utf-8")
    text = json.dumps(diagnosis.to_json(), allow_nan=False)
    assert from_json(json.loads(text)) == diagnosis.verdict
