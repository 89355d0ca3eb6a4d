"""The door: what `import modelgap as mg` gives, takes, and does not load."""

import doctest
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pyarrow as pa
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
from tests.checkout import ROOT
from tests.residual.test_model_record import model_of
from warehouse.record_commit import commit_run

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


# What the door takes: logs from memory, checked as files are; robots and recordings.


HIDDEN = ROOT / "examples" / "hidden"
LOG = HIDDEN / "fit_3.csv"


@pytest.fixture(scope="module")
def robot():
    return mg.load_robot("irb140")


@pytest.fixture(scope="module")
def file(robot):
    return mg.read_logs(LOG, robot)[0]


@pytest.fixture(scope="module")
def table():
    read = np.genfromtxt(LOG, delimiter=",", names=True)
    return {name: read[name] for name in read.dtype.names}


class Frame:
    """What pandas and Polars have in common."""

    def __init__(self, table):
        self._table, self.columns = table, list(table)

    def __getitem__(self, name):
        return self._table[name]


def same(log, other):
    for name in ("t", "q", "tau"):
        np.testing.assert_array_equal(getattr(log, name), getattr(other, name))


@pytest.mark.parametrize("kind", [dict, Frame, pa.table], ids=["dict", "frame", "arrow"])
def test_columns_in_memory_are_the_log_that_a_file_is(robot, table, file, kind):
    (log,) = mg.read_logs(kind(table), robot)
    same(log, file)


def test_arrays_are_a_recording_in_si_units(robot, file):
    log = mg.recording(robot, t=file.t, q=file.q, tau=file.tau, id="mine")
    same(log, file)
    assert (log.id, log.robot, log.qd) == ("mine", "irb140", None)
    (log,) = mg.read_logs({"t": file.t, "q": file.q, "tau": file.tau}, robot)
    same(log, file)


BAD = {
    "shape": ({"t": slice(9), "q": 1, "tau": 1}, r"q has shape \(2500, 6\)"),
    "degrees": ({"t": 1, "q": 57.3, "tau": 1}, "Degrees"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_log_is_refused_in_words(robot, file, name):
    given, message = BAD[name]
    arrays = {}
    for key, how in given.items():
        own = getattr(file, key)
        arrays[key] = own[how] if isinstance(how, slice) else how * own
    with pytest.raises(mg.InputError, match=message):
        mg.recording(robot, **arrays)


def test_text_and_columns_of_other_lengths_are_refused(robot, table):
    with pytest.raises(mg.InputError, match="expected numbers"):
        mg.read_logs({**table, "q3": np.array(["x"] * 2500)}, robot)
    with pytest.raises(mg.InputError, match="differ in length"):
        mg.read_logs({**table, "q3": table["q3"][:-1]}, robot)


FITS = (mg.diagnose, mg.identify, mg.calibrate, mg.next_experiment)


@pytest.mark.parametrize("fit", FITS)
def test_a_fit_takes_a_robot_and_recordings(fit, robot, file):
    with pytest.raises(mg.InputError, match=r"robot: .*mg.load_robot.*got 'irb140'"):
        fit("irb140", [file])
    for logs in ("A.csv", ["A.csv"], [file, "A.csv"]):
        with pytest.raises(mg.InputError, match=r"fit: .*mg.read_logs.*got 'A.csv'"):
            fit(robot, logs)
    with pytest.raises(mg.InputError, match="No log to fit"):
        fit(robot, [])


def test_other_recordings_and_models_are_checked_too(robot, file):
    for refused, call in {
        r"held_out: .* got 'C.csv'": lambda: mg.diagnose(robot, [file], "C.csv"),
        r"watched: .* got 'C.csv'": lambda: mg.monitor(None, [file], ["C.csv"]),
        "No log to check": lambda: mg.check(robot, []),
        "give models by name": lambda: mg.compare([1], [file]),
        r"logs: .* got 'C.csv'": lambda: mg.compare({"with": 1}, "C.csv"),
        "Unknown effect .v": lambda: mg.identify(robot, [file], declared="viscous"),
    }.items():
        with pytest.raises(mg.InputError, match=refused):
            call()


# The loop from a script: simulate, watch, ask for the next motion.


SHORT = {"trajectory": {"kind": "cyclic", "duration": 5.0}}
SHORT["rates"] = {"control": 500, "log": 125}
STIFF = {"plant": {"effect": [{"name": "coulomb", "joints": [2], "level": 30.0}]}}


@pytest.fixture(scope="module")
def healthy():
    return [mg.simulate({**SHORT, "seed": seed}) for seed in range(4)]


def test_a_joint_that_got_stiff_is_told_and_a_healthy_one_is_not(healthy):
    model = mg.identify(mg.load_robot("irb140"), healthy[:3]).models["identified"]
    odd = mg.simulate({**SHORT, **STIFF, "seed": 9})
    report = mg.monitor(model, healthy[:3], [odd, healthy[3]])
    assert 2 in {alarm.joint for alarm in report.alarms[odd.id]}
    assert 2 not in {alarm.joint for alarm in report.alarms[healthy[3].id]}


def test_what_is_simulated_twice_is_one_log(healthy):
    again = mg.simulate({**SHORT, "seed": 0})
    assert again.id == healthy[0].id
    assert (again.tau == healthy[0].tau).all()
    with pytest.raises(mg.InputError, match=again.id):
        mg.monitor(None, [*healthy[:2], again], healthy[3:])


def test_what_cannot_be_asked_is_refused_before_anything_is_fitted():
    with pytest.raises(mg.InputError, match="expected 4 to 600"):
        mg.next_experiment(mg.load_robot("irb140"), [], seconds=1.0)


def test_an_unknown_key_of_an_experiment_is_refused():
    with pytest.raises(mg.InputError, match="trajectry"):
        mg.simulate({"trajectry": {}})


# docs/api.md and the notebook of the examples run, and print what they show.


_FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def _sections() -> dict[str, str]:
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    _, first, *rest = re.split(r"^#+ (.*)$", page, flags=re.M)
    below = iter([first, *rest])
    return dict(zip(below, below, strict=True))


def _run(text: str, known: dict) -> None:
    cells = doctest.DocTestParser().get_doctest(text, known, "api.md", None, 0)
    told: list[str] = []
    done = doctest.DocTestRunner(optionflags=_FLAGS).run(cells, out=told.append)
    assert done.attempted
    assert told == []


@pytest.fixture
def folder(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "examples" / "hidden", tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    (log,) = mg.read_logs("fit_1.csv@0:2", mg.load_robot("irb140"))
    commit_run(tmp_path / "store", log, {"spec": {"robot": "irb140"}})
    return tmp_path


@pytest.mark.long
def test_the_cells_of_the_page_print_what_it_shows(folder):
    page = _sections()
    page.pop("Calibrate")
    _run("\n".join(page.values()), {})
    assert (folder / "out.html").read_text(encoding="utf-8").startswith("<!doctype")


@pytest.mark.long
def test_the_cell_that_calibrates_prints_what_it_shows(folder):
    known = {"mg": mg, "robot": mg.load_robot("irb140")}
    _run(_sections()["Calibrate"], known)
