"""The flows of Prefect: their order, what they leave behind, and where."""

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from flows.scheduled import night as watch
from flows.scheduled import stages
from flows.scheduled.surroundings import Around, surrounded
from flows.service import server as server_of
from flows.steps import demo as steps
from tests.flows.blind_rows import row
from tests.waiting import until

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.prefect


@pytest.fixture
def order(monkeypatch, tmp_path):
    """Replace the steps of both flows; returns the order in which they are taken."""
    page = tmp_path / "report.html"
    page.write_text("<html>")
    taken = []

    def take(module, name, answer):
        def step(*given):
            taken.append((name, given))
            if isinstance(answer, Exception):
                raise answer
            return answer

        monkeypatch.setattr(module, name, step)

    runs = {"fit": ["aa", "bb"], "held_out": ["cc"]}
    hidden = [{"name": "spring", "joints": [2], "parameters": {"stiffness": 4.0}}]
    take(steps, "run_experiments", runs)
    take(steps, "diagnose", ("dd", "ee"))
    take(steps, "open_seal", hidden)
    take(steps, "report", page)
    take(steps, "headline", "Nothing is missing.")
    take(watch, "run_campaign", watch.Ran(runs, ("aa",), ("one failed",)))
    for name in ("identify", "calibrate", "validate"):
        take(stages, name, stages.Stage((name,), f"{name} done", ({"J1": 1.0},)))
    take(watch, "diagnose", ("dd", "ee"))
    take(watch, "report", (page, "Nothing is missing."))
    return taken


def test_the_seal_is_opened_after_the_verdict_is_stored(server, order, tmp_path):
    from flows.scheduled.demo import demo

    done = demo(3, None, str(tmp_path))
    names = [name for name, _ in order]
    assert names[:4] == ["run_experiments", "diagnose", "open_seal", "report"]
    assert done["diagnosis"] == "dd"
    assert done["hidden"][0]["name"] == "spring"
    assert done["page"] == str(tmp_path / "report.html")


def test_the_steps_of_a_flow_get_progress_and_processes_of_its_command(server, order):
    from flows.scheduled.demo import demo

    told, pool = print, object()
    with surrounded(Around(told, pool)):
        demo(3, "spring", "store")
    (_, given), (_, given_to_diagnose) = order[:2]
    assert given == (steps.Asked(3, "spring"), Path("store"), told, pool)
    assert given_to_diagnose[-1] is told


def test_a_failing_step_fails_the_flow_with_its_own_error(server, order, monkeypatch):
    from flows.errors import RunError
    from flows.scheduled.demo import demo

    def fail(*_):
        raise RunError("Experiment welding failed: joint 2 at 1.2 s")

    monkeypatch.setattr(steps, "run_experiments", fail)
    with pytest.raises(RunError, match="joint 2 at"):
        demo(3, None, "store")
    assert order == []


def test_a_night_has_a_seed_of_its_own_and_survives_a_failure(
    server, order, tmp_path, monkeypatch
):
    from flows.scheduled.nightly import nightly

    monkeypatch.setenv("MODELGAP_STORE", str(tmp_path))
    assert nightly() == str(tmp_path / "report.html")
    (name, given), *rest = order
    assert name == "run_campaign"
    asked, store, _ = given
    assert (asked.path, asked.held_out) == ("examples/nightly.toml", "welding")
    assert 20260101 < asked.seed < 21000101
    assert store == tmp_path
    stages_taken = ["identify", "calibrate", "validate", "diagnose", "report"]
    assert [name for name, _ in rest] == stages_taken
    assert rest[2][1][0] == ["cc"]  # what was held out is validated


def test_report_and_verdict_appear_among_the_artifacts(server, order, tmp_path):
    from prefect.artifacts import Artifact

    from flows.scheduled.nightly import nightly

    nightly(store=str(tmp_path))
    assert "report.html" in Artifact.get("report").data
    assert Artifact.get("verdict").data == "Nothing is missing."
    assert json.loads(Artifact.get("calibrate").data) == [{"J1": 1.0}]
    assert Artifact.get("campaign-progress").type == "progress"


def test_the_flow_of_a_blind_study_runs_it_and_links_its_page(
    server, monkeypatch, tmp_path
):
    from flows.blind.sums import summary
    from flows.scheduled import blind as blind_flow

    asked = []
    rows = [row("single", "right", multiple=3.0)]
    made = SimpleNamespace(
        rows=rows, summary=summary(rows), id="aa", failed=("case 1",)
    )

    def run_study(study, store, tell):
        asked.append((study.n, study.seed, store))
        tell("case 0 judged", 1.0)
        return made

    page = tmp_path / "report.html"
    monkeypatch.setattr(blind_flow.blind_run, "run_study", run_study)
    monkeypatch.setattr(blind_flow, "store_page", lambda *given: page)
    assert blind_flow.blind(7, 3, str(tmp_path)) == str(page)
    assert asked == [(7, 3, tmp_path)]
    # Without a seed it is the day of the schedule.
    blind_flow.blind(2, None, str(tmp_path))
    assert 20200101 < asked[1][1] < 21000101


def _deployments() -> list[dict]:
    return yaml.safe_load((ROOT / "prefect.yaml").read_text())["deployments"]


def test_every_deployment_names_a_flow_and_parameters_that_exist(server):
    from importlib import import_module

    names = [d["name"] for d in _deployments()]
    assert names[:3] == ["nightly", "monitor", "diagnose"]
    for deployment in _deployments():
        module, _, name = deployment["entrypoint"].rpartition(".")
        flow = getattr(import_module(module), name)
        known = set(flow.parameters.properties)
        own = deployment.get("parameters", {})
        more = [*deployment["schedules"], *deployment.get("triggers", [])]
        for given in (own, *(each.get("parameters", {}) for each in more)):
            assert set(given) <= known, deployment["name"]
            file = given.get("campaign_file")
            assert file is None or (ROOT / file).is_file()


def test_the_events_of_the_deployments_are_those_that_flows_send(server):
    from flows.scheduled import events

    expected = {
        (d["name"], event, trigger["match"]["prefect.resource.id"])
        for d in _deployments()
        for trigger in d.get("triggers", ())
        for event in trigger["expect"]
    }
    assert expected == {
        ("monitor", events.COMMITTED, events.STORE),
        ("diagnose", events.ALARM, events.STORE),
    }


def test_only_what_lies_outside_is_tried_again(server):
    from prefect.states import Failed

    from flows.scheduled import tasks
    from flows.workers.cluster import ClusterLostError
    from residual.errors import InputError

    again = {
        error: tasks.outside(None, None, Failed(data=error))
        for error in (OSError(), ClusterLostError(), InputError(), ValueError())
    }
    assert [*again.values()] == [True, True, False, False]


def _bare() -> dict[str, str]:
    """Return the environment without a word about Prefect."""
    return {k: v for k, v in os.environ.items() if not k.startswith("PREFECT")}


def test_prefect_is_prepared_to_be_quiet_and_at_home_in_the_store(tmp_path):
    code = (
        "import sys; from pathlib import Path; from flows.settings import "
        f"prepare_prefect; prepare_prefect(Path({str(tmp_path)!r})); "
        "assert 'prefect' not in sys.modules; import prefect.settings as s; "
        "c = s.get_current_settings(); print(c.home, c.api.url, "
        "c.server.analytics_enabled, c.results.default_serializer)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=_bare(),
        capture_output=True,
        text=True,
    )
    assert done.stderr == ""
    assert done.stdout.split() == [str(tmp_path), "None", "False", "json"]


@pytest.mark.slow
def test_our_server_answers_and_ends_when_its_owner_is_killed(tmp_path):
    code = (
        "import time; from pathlib import Path; from flows.settings import "
        f"prepare_prefect; from flows.service.server import start_server; home = "
        f"Path({str(tmp_path)!r}); prepare_prefect(home); own = start_server(home); "
        "own.wait(); print(own.url, own.process.pid, flush=True); time.sleep(600)"
    )
    owner = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=_bare(),
        stdout=subprocess.PIPE,
        text=True,
    )
    url, process = owner.stdout.readline().split()
    until(lambda: server_of.answers(url), "the server answers")
    owner.kill()
    owner.wait()
    # An ended process that nobody has taken note of yet has no command line.
    command = Path(f"/proc/{process}/cmdline")
    until(lambda: not command.exists() or not command.read_bytes(), "it has ended")
    assert not server_of.answers(url)


def test_an_address_that_is_none_is_no_server():
    assert not server_of.answers(None)
    assert not server_of.answers("nonsense")
