"""A real server, a real worker, a real schedule that fires: started once."""

import json
import os
import signal
import sqlite3
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import StringIO
from types import SimpleNamespace

import pytest

from flows.cli import main
from flows.service import api
from flows.service.state import read_running, store_key
from flows.service.up import start_every
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
    return SimpleNamespace(
        returncode=code, stdout=out.getvalue(), stderr=err.getvalue()
    )


@pytest.fixture(scope="session")
def service(tmp_path_factory):
    """A store that was brought up as by a user, from another folder."""
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
            api=api.Api(f"http://127.0.0.1:{port}/api", store_key(home)),
        )
    finally:
        modelgap("down", "--wait", "0", *words)


def runs_of(service, deployment: str) -> list[dict]:
    wanted = {"deployments": {"name": {"any_": [deployment]}}}
    return api.ask(service.api, "/flow_runs/filter", wanted)


def completed(service, deployment: str) -> list[dict]:
    runs = runs_of(service, deployment)
    failed = [r["state"]["message"] for r in runs if r["state_type"] == "FAILED"]
    assert not failed
    return [r for r in runs if r["state_type"] == "COMPLETED"]


def test_up_gives_the_address_and_a_second_one_changes_nothing(service):
    assert service.ui in service.said
    before = read_running(service.home)
    again = modelgap("up", *service.words)
    assert again.returncode == 0
    assert f"already runs: {service.ui}" in again.stdout
    assert read_running(service.home) == before
    assert service.api.key not in service.said + again.stdout + again.stderr


@pytest.mark.long
def test_a_schedule_fires_and_its_event_starts_the_monitoring(service):
    given = {"campaign_file": str(service.folder / "c.toml")}
    start_every(service.api, "campaign/campaign", 15, given)
    until(lambda: completed(service, "campaign"), "the campaign has ended", 0.5)
    start_every(service.api, "campaign/campaign", 0)
    asked = modelgap(
        "sql", "SELECT run_id FROM runs", "--format", "json", *service.words
    )
    stored = {row["run_id"] for row in json.loads(asked.stdout)}
    assert len(stored) == 2
    (watched,) = until(
        lambda: completed(service, "monitor"), "the monitoring has ended", 0.5
    )
    assert set(watched["parameters"]["runs"]) == stored


@pytest.mark.long
def test_after_a_kill_up_starts_anew_and_closes_what_was_left(service):
    given = {"deployments": {"name": {"any_": ["campaign"]}}}
    (deployment,) = api.ask(service.api, "/deployments/filter", given)
    left = {"type": "RUNNING", "name": "Running"}
    place = f"/deployments/{deployment['id']}/create_flow_run"
    pool = {"state": {"type": "SCHEDULED"}, "name": "left"}
    api.ask(service.api, f"/work_pools/{api.POOL}", {"is_paused": True}, "PATCH")
    run = api.ask(service.api, place, pool)
    path = f"/flow_runs/{run['id']}/set_state"
    api.ask(service.api, path, {"state": left, "force": True})
    known = len(runs_of(service, "campaign"))
    for process in read_running(service.home).processes:
        os.kill(process.pid, signal.SIGKILL)
    until(lambda: not read_running(service.home).alive, "all is killed")
    sick = modelgap("status", *service.words)
    assert sick.returncode == 1
    assert "does not answer" in sick.stdout

    done = modelgap("up", *service.words)
    assert done.returncode == 0, done.stderr
    assert "nobody runs it any more: left" in done.stderr
    assert service.ui in done.stdout  # where it was
    assert len(runs_of(service, "campaign")) >= known
    well = modelgap("status", "--json", *service.words)
    told = json.loads(well.stdout)
    assert (well.returncode, told["healthy"]) == (0, True)
    assert told["workers"] == {"worker-1": "online"}
    states = {r["name"]: r["state"] for r in told["runs"]}
    assert states["left"] == "Crashed"
    names = [d["name"] for d in told["deployments"]]
    assert {"nightly/nightly", "monitor/monitor", "diagnose/diagnose"} <= set(names)


def test_down_stops_all_and_the_schedules_stay(service):
    processes = read_running(service.home).processes
    assert modelgap("down", "--wait", "5", *service.words).returncode == 0
    assert not any(p.lives for p in processes)
    assert modelgap("status", *service.words).returncode == 1
    with sqlite3.connect(service.home / "prefect.db") as history:
        active = history.execute(
            "SELECT count(*) FROM deployment_schedule WHERE active"
        ).fetchone()
    assert active[0] >= 1
