"""A diagnosis without the numerics: the core and the report replaced by fakes."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from flows.service.key import CLIENT
from flows.settings import API, quiet_prefect
from residual.check.result import LogCheck
from residual.diagnosis.result import Diagnosis
from tests.verdict_documents import typed

ROOT = Path(__file__).parents[2]
# Ends with us, since it then has no input any more, and its server with it.
OWNER = """
import sys
from pathlib import Path
from flows.service.server import start_server
from flows.settings import prepare_prefect

home = Path(sys.argv[1])
prepare_prefect(home)
own = start_server(home)
own.wait()
print(own.url, own.process.pid, own.key, flush=True)
sys.stdin.read()
"""
PATIENCE = 10.0  # s that messages to a server which was killed are waited for
JOINTS = range(1, 7)
NAMES = ("t", *(f"q{i}" for i in JOINTS), *(f"tau{i}" for i in JOINTS))


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A Prefect server for one file of tests, its database in a folder of ours.

    A process of its own has started it, so that a test can kill the owner.
    """
    home = tmp_path_factory.mktemp("prefect")
    owner = subprocess.Popen(
        [sys.executable, "-c", OWNER, str(home)],
        cwd=ROOT,
        env={k: v for k, v in os.environ.items() if not k.startswith("PREFECT")},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    url, process, key = owner.stdout.readline().split()
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {**quiet_prefect(home), API: url, CLIENT: key}.items():
            patch.setenv(name, value)
        from prefect import settings

        updates = {
            settings.PREFECT_HOME: home,
            settings.PREFECT_API_URL: url,
            settings.PREFECT_API_AUTH_STRING: key,
            settings.PREFECT_LOGGING_TO_API_ENABLED: False,  # they may come too late
            # Without a heartbeat a flow ends when it ends, and not a second later.
            settings.PREFECT_FLOWS_HEARTBEAT_FREQUENCY: None,
        }
        with settings.temporary_settings(updates):
            yield SimpleNamespace(url=url, process=process, owner=owner)
            # Prefect keeps its clients for the life of a process: the next file's flows
            # would ask this server for their slots.
            from prefect._internal.concurrency.services import _QueueServiceBase

            _QueueServiceBase.drain_all(timeout=PATIENCE, at_exit=False)
    owner.kill()
    owner.wait()


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

    def print_diagnosis(found, console, verbose=False):
        console.print(f"verdict {found.verdict.verdict}")

    def render(outcome, robot_name, motion=None):
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
