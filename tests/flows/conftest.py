"""A diagnosis without the numerics: the core and the report replaced by fakes."""

import numpy as np
import pytest

from flows.service.server import start_server
from flows.settings import API, quiet_prefect
from residual.check.result import LogCheck
from residual.diagnosis.result import Diagnosis
from tests.verdict_documents import typed

JOINTS = range(1, 7)
NAMES = ("t", *(f"q{i}" for i in JOINTS), *(f"tau{i}" for i in JOINTS))


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A Prefect server for one file of tests, its database in a folder of ours."""
    home = tmp_path_factory.mktemp("prefect")
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(API, raising=False)
        for name, value in quiet_prefect(home).items():
            patch.setenv(name, value)
        own = start_server(home)
        own.wait()
        patch.setenv(API, own.url)
        from prefect import settings

        updates = {
            settings.PREFECT_HOME: home,
            settings.PREFECT_API_URL: own.url,
            settings.PREFECT_LOGGING_TO_API_ENABLED: False,  # they may come too late
            # Without a heartbeat a flow ends when it ends, and not a second later.
            settings.PREFECT_FLOWS_HEARTBEAT_FREQUENCY: None,
        }
        with settings.temporary_settings(updates):
            yield
        own.stop()


@pytest.fixture
def calls(monkeypatch):
    """Replace core, check and report; returns the list of calls of the core."""
    made = []

    def close_the_loop(robot, fit, **options):
        made.append({"robot": robot.name, "fit": fit, **options})
        if options["progress"]:
            options["progress"]("search", 0.5)
        verdict = typed({"robot": robot.name, "warnings": ["core"]})
        return Diagnosis(verdict, notes=("core note",))

    def print_diagnosis(found, console):
        console.print(f"verdict {found.verdict.verdict}")

    def render(outcome, robot_name):
        return f"<html>{robot_name} {outcome.notes}</html>"

    monkeypatch.setattr("flows.steps.diagnose.close_the_loop", close_the_loop)
    monkeypatch.setattr("flows.steps.check.check_logs", lambda *_: LogCheck(()))
    monkeypatch.setattr("flows.cli.diagnose.print_diagnosis", print_diagnosis)
    monkeypatch.setattr("flows.report.page.diagnosis.render", render)
    return made


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working directory with the logs A.csv, B.csv and C.csv of irb140."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(2)
    t = np.arange(300) / 100
    for name in "ABC":
        q = 0.5 * np.sin(t[:, None] * np.arange(1, 7) / 2 + rng.normal(size=6))
        table = np.column_stack([t, q, rng.normal(size=(300, 6))])
        np.savetxt(
            tmp_path / f"{name}.csv",
            table,
            delimiter=",",
            header=",".join(NAMES),
            comments="",
        )
    return tmp_path
