"""A Prefect server, nights of an arm, a diagnosis whose core and report are fakes."""

import fcntl
import os
import pickle
from dataclasses import replace
from functools import partial
from shutil import copytree

import numpy as np
import pytest

from flows.cli import main
from flows.report.charts import render_diagnosis_page
from residual.calibration import calibrate as core
from residual.calibration.nominal_pls import NominalPlsForm
from residual.check.result import LogCheck
from residual.recording import Recording
from residual.verdict.result import Diagnosis
from sim.engine.plant_records import PlantRun
from tests.flows import report_outcomes
from tests.flows.adopted_arm import make_nights
from tests.flows.prefect_server import server_settings, started
from tests.synthetic.logs import write_csv
from tests.verdict_documents import typed


@pytest.fixture(scope="session")
def servers(tmp_path_factory):
    """The server of this process in a list, so that one that was killed is replaced."""
    running = []
    yield running
    for server in running:
        server.end()


@pytest.fixture(scope="module")
def server(servers, tmp_path_factory):
    """One Prefect server for all files of tests; each asks it for itself."""
    if not servers or not servers[-1].lives:
        servers.append(started(tmp_path_factory.mktemp("prefect")))
    with server_settings(servers[-1]):
        yield servers[-1]


@pytest.fixture(scope="session")
def nights_made(tmp_path_factory, compiled_plant):
    """Nights of an arm with a spring, made once for all test processes."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    kept = shared / "nights.pickle"
    with (shared / "nights.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kept.exists():
            kept.write_bytes(pickle.dumps(make_nights(shared / "nights_made")))
    return pickle.loads(kept.read_bytes())


@pytest.fixture(scope="module")
def arm_nights(nights_made, tmp_path_factory):
    store = tmp_path_factory.mktemp("nights") / "store"
    copytree(nights_made.store, store)
    return replace(nights_made, store=store)


@pytest.fixture
def plant(monkeypatch):
    """Replace plant and motion by noise of the seeds; more is added to its torque."""
    more = {"tau": 0.0, "specs": []}

    def simulate(spec, robot, store):
        more["specs"].append(spec)
        rng = np.random.default_rng([spec.reference().seed, spec.plant_spec().seed])
        q, tau, error = rng.normal(size=(3, 50, robot.dof))
        tau[20:, 2] += more["tau"]
        log = Recording("", robot.name, spec.start + np.arange(50) / 250, q, tau)
        run = PlantRun(log, {"tau_spring": 2 * q}, {"e_q": error})
        return run, {"reference_s": 0.1, "plant_s": 0.2}

    monkeypatch.setattr("flows.steps.experiment._simulate", simulate)
    return more


@pytest.fixture
def cli(capsys):
    def run(*words):
        code = main(words[0].split() if len(words) == 1 else words)
        shown = capsys.readouterr()
        return code, shown.out, shown.err

    return run


@pytest.fixture(scope="session")
def several_page():
    return render_diagnosis_page(report_outcomes.several(), "kr300")


@pytest.fixture
def few_tables(monkeypatch):
    """A calibration of fewer levels and components: same words, quick numbers."""
    lean = partial(core.CalibrationSettings, form=NominalPlsForm(6, 4))
    monkeypatch.setattr("flows.steps.fit.CalibrationSettings", lean)
    monkeypatch.setattr("residual.calibration.correction_choice.LEVELS", 10)
    monkeypatch.setattr("residual.calibration.validation_scores.SWEEP", (2, 5))


@pytest.fixture
def calls(monkeypatch):
    """Replace core, check and report; returns the list of calls of the core."""
    requests = []

    def diagnose(robot, fit, **options):
        requests.append({"robot": robot.name, "fit": fit, **options})
        if options["progress"]:
            options["progress"]("search", 0.5)
        verdict = typed({"robot": robot.name, "warnings": [*options["warnings"], "core"]})
        return Diagnosis(verdict, notes=("core note",))

    def print_diagnosis(found, console):
        console.print(f"verdict {found.verdict.verdict}")

    def drawn(outcome, robot_name, motion=None, origin=()):
        return f"<html>{robot_name} {outcome.notes} {origin[-1][1]}</html>"

    monkeypatch.setattr("residual.diagnosis.diagnose.diagnose", diagnose)
    monkeypatch.setattr("flows.steps.check.check_logs", lambda *_: LogCheck(()))
    monkeypatch.setattr("flows.report.diagnosis.print_diagnosis", print_diagnosis)
    monkeypatch.setattr("flows.report.charts.render_diagnosis_page", drawn)
    return requests


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(2)
    t = np.arange(300) / 100
    for name in "ABC":
        q = 0.5 * np.sin(t[:, None] * np.arange(1, 7) / 2 + rng.normal(size=6))
        log = Recording(name, "irb140", t, q, rng.normal(size=(300, 6)))
        write_csv(tmp_path / f"{name}.csv", log)
    return tmp_path
