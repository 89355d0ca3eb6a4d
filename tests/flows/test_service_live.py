"""A real server, a real worker, a real schedule that fires: started once."""

import json
import os
import signal
import sqlite3
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import StringIO
from types import SimpleNamespace

import pytest
from prefect.client.schemas.filters import DeploymentFilter

from flows.cli import main
from flows.project import POOL
from flows.service import api
from flows.service.state import PROCESSES, read_access_key, read_running
from flows.service.state import is_process_running as is_running
from flows.service.up import schedule_every
from tests.flows.prefect_server import free_port
from tests.waiting import until

CAMPAIGN = """
schema = 1
robot = "irb140"
[trajectory]
duration = 4.0
[grid]
seed = [1, 2]
"""

pytestmark = [pytest.mark.prefect, pytest.mark.slow]


def modelgap(*words: str) -> SimpleNamespace:
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(words)
    return SimpleNamespace(returncode=code, stdout=out.getvalue(), stderr=err.getvalue())


@pytest.fixture(scope="session")
def service(tmp_path_factory):
    folder = tmp_path_factory.mktemp("service")
    port = str(free_port())
    words = ["--store", str(folder / "store")]
    try:
        with chdir(folder):
            done = modelgap("up", "--port", port, *words)
        assert done.returncode == 0, done.stderr
        (folder / "c.toml").write_text(CAMPAIGN)
        home = folder / "store" / "_prefect"
        yield SimpleNamespace(
            words=words,
            folder=folder,
            home=home,
            said=done.stdout,
            ui=f"http://127.0.0.1:{port}",
            api=api.Api(f"http://127.0.0.1:{port}/api", read_access_key(home)),
        )
    finally:
        modelgap("down", "--wait", "0", *words)


def runs_of(service, deployment: str) -> list:
    wanted = DeploymentFilter(name={"any_": [deployment]})
    with service.api.client() as client:
        return client.read_flow_runs(deployment_filter=wanted)


def completed(service, deployment: str) -> list:
    runs = runs_of(service, deployment)
    assert [run.state.message for run in runs if run.state_name == "Failed"] == []
    return [run for run in runs if run.state_name == "Completed"]


def test_up_gives_the_address_and_a_second_one_changes_nothing(service):
    assert service.ui in service.said
    before = read_running(service.home)
    again = modelgap("up", *service.words)
    assert again.returncode == 0
    assert f"already running: {service.ui}" in again.stdout
    assert read_running(service.home) == before
    assert service.api.key not in service.said + again.stdout + again.stderr
    # What the plain command of Prefect needs, and what there is to start.
    assert f"export PREFECT_API_URL={service.ui}/api" in again.stdout
    key = service.home / "key"
    assert f'export PREFECT_API_AUTH_STRING="$(cat {key})"' in again.stdout
    assert "deployed: nightly, monitor, alarm, propose, campaign" in again.stdout
    with service.api.client() as client:
        assert client.read_work_pool(POOL).concurrency_limit == 1


def test_up_with_other_workers_changes_how_many_flows_run_at_once(service):
    assert modelgap("up", "--workers", "2", *service.words).returncode == 0
    with service.api.client() as client:
        assert client.read_work_pool(POOL).concurrency_limit == 2


@pytest.mark.long
def test_a_schedule_fires_and_its_event_starts_the_monitoring(service):
    given = {"campaign_file": str(service.folder / "c.toml")}
    with service.api.client() as client:
        schedule_every(client, "campaign/campaign", 15, given)
        until(lambda: completed(service, "campaign"), "the campaign has ended", 0.5)
        schedule_every(client, "campaign/campaign", 0)
    shown = modelgap("sql", "SELECT run_id FROM runs", "--format", "json", *service.words)
    stored = {row["run_id"] for row in json.loads(shown.stdout)}
    assert len(stored) == 2
    (watched,) = until(lambda: completed(service, "monitor"), "the monitoring has ended", 0.5)
    assert set(watched.parameters["runs"]) == stored


@pytest.mark.long
def test_after_a_kill_status_says_what_is_gone_and_up_starts_it_where_it_was(service):
    known = len(runs_of(service, "campaign"))
    for name in PROCESSES:
        os.kill(int((service.home / f"{name}.pid").read_text()), signal.SIGKILL)
    for name in PROCESSES:
        until(lambda name=name: not is_running(service.home, name), f"{name} is killed")
    sick = modelgap("status", *service.words)
    assert sick.returncode == 1
    assert "the server has ended" in sick.stderr

    done = modelgap("up", *service.words)
    assert done.returncode == 0, done.stderr
    assert service.ui in done.stdout  # where it was
    assert len(runs_of(service, "campaign")) >= known
    well = modelgap("status", "--json", *service.words)
    document = json.loads(well.stdout)
    state = (document["healthy"], document["worker"])
    assert (well.returncode, *state) == (0, True, "online")
    names = [d["name"] for d in document["deployments"]]
    assert {"nightly/nightly", "monitor/monitor", "diagnose-new/alarm"} <= set(names)


def test_down_stops_all_and_the_schedules_stay(service):
    assert modelgap("down", "--wait", "5", *service.words).returncode == 0
    assert not any(is_running(service.home, name) for name in PROCESSES)
    stopped = modelgap("status", *service.words)
    assert (stopped.returncode, "is stopped" in stopped.stderr) == (1, True)
    with sqlite3.connect(service.home / "prefect.db") as history:
        active = history.execute("SELECT count(*) FROM deployment_schedule WHERE active").fetchone()
    assert active[0] >= 1
