"""The flows of Prefect: their order, what they leave behind, and where."""

from datetime import UTC, datetime
from types import SimpleNamespace

import httpx
import numpy as np
import pytest
import yaml

from flows.report import ReportTable, store_index
from flows.settings import PAGES
from flows.steps import diagnose, fit, validate
from flows.steps import experiment as campaign
from flows.steps.experiment import compute_run_id
from flows.steps.model_choice import ModelChoice
from flows.workers import RUNNER, InlineExecutor
from residual.errors import InputError, RunError
from tests.checkout import ROOT
from tests.verdict_documents import typed
from tests.waiting import until
from warehouse.record_ids import build_record_path
from warehouse.store_catalogue import read_channels

# The flows without their steps: what is taken, and in which order.


NAME = "irb140 #2: load friction on joint 2, 9.6 → 7.1 %"
SCORES = fit.StoredCalibration(SimpleNamespace(), (), {"model": "aa"})


def faked(monkeypatch, tmp_path):
    """Replace the steps of both flows; returns the order in which they are taken.

    To be called when Prefect has its settings.
    """
    from flows.pipelines import flows as nightly
    from flows.pipelines import tasks

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

    due = datetime(2026, 11, 22, 2, tzinfo=UTC)
    clock = SimpleNamespace(scheduled_start_time=due)
    monkeypatch.setattr(nightly, "flow_run", clock)
    runs = {"fit": ["aa", "bb"], "held_out": ["cc"]}
    take(store_index, "store_diagnosis_page", page)
    take(nightly, "run_campaign", SimpleNamespace(new=("aa",), failed={}))
    monkeypatch.setattr(campaign, "group_runs_by_role", lambda *_: runs)
    monkeypatch.setattr(tasks, "read_verdict", lambda *_: typed({}))
    monkeypatch.setattr(diagnose, "build_diagnose_request", lambda *asked: asked)
    for module, name, answer in (
        (nightly, "resolve_adopted_model", ModelChoice("11" * 10, "model: adoption 3")),
        (nightly, "judge_adoption", SimpleNamespace(doubts=("nothing new",), verdict=typed({}))),
    ):
        take(module, name, answer)
    take(diagnose, "diagnose_stored_runs", ("dd", "ee"))
    monkeypatch.setattr(tasks, "read_run_robot", lambda runs, store: "irb140")
    monkeypatch.setattr(tasks, "format_run_name", lambda *_: NAME)
    for name in ("read_identification_logs", "read_calibration_runs"):
        monkeypatch.setattr(fit, name, lambda request: ((), ()))
    table = ReportTable(("model", "J1"), [("ls", "1.0")])
    for name in ("identified_parts", "calibrated_parts"):
        monkeypatch.setattr(tasks, name, lambda made: ["All of it.", table])
    monkeypatch.setattr(
        tasks.experiments, "build_validation_parts", lambda *_: ["All of it.", table]
    )
    take(fit, "identify", (SimpleNamespace(), "ff"))
    take(fit, "calibrate", SCORES)
    take(validate, "validate", ("ab", validate.Validation(0.25, np.array([0.001]))))
    return taken


# The flows of Prefect: their order, what they leave behind, and where.


pytestmark = pytest.mark.prefect


@pytest.fixture(scope="module")
def flows(server):
    """All flows, loaded only now: Prefect takes its settings when it is."""
    from flows.pipelines import flows as nightly

    return nightly


@pytest.fixture
def order(flows, monkeypatch, tmp_path):
    """Replace the steps of both flows; returns the order in which they are taken."""
    return faked(monkeypatch, tmp_path)


def test_what_a_diagnosis_does_not_need_fails_the_night_when_it_is_done(flows, order, monkeypatch):
    def fail(*_):
        raise RunError("no tables")

    monkeypatch.setattr(flows.tasks.fitting, "calibrate", fail)
    with pytest.raises(RunError, match="no tables"):
        flows.nightly("CAMPAIGN.toml", store="store")
    assert [name for name, _ in order][-1] == "judge_adoption"


def lose_an_answer(patch):
    """Lose the server's answer to the first artifact, as on a busy machine.

    Prefect's client asks again, and the server keeps what it gets a second time too:
    it gives each artifact an id of its own.
    """
    send, lost = httpx.Client.send, []

    def lose(client, request, **more):
        answer = send(client, request, **more)
        if request.method == "POST" and request.url.path == "/api/artifacts/":
            lost.append(request)
            if len(lost) == 1:
                raise httpx.ReadTimeout("lost", request=request)
        return answer

    patch.setattr(httpx.Client, "send", lose)


@pytest.fixture(scope="module")
def night(flows, tmp_path_factory):
    """A night with a finding: its folder, state, steps in their order, and notices."""
    folder, events = tmp_path_factory.mktemp("night"), []
    with pytest.MonkeyPatch.context() as patch:
        order = faked(patch, folder)
        lose_an_answer(patch)
        patch.setenv("MODELGAP_STORE", str(folder))
        patch.setenv(PAGES, "http://127.0.0.1:4200/pages")
        tasks = flows.tasks
        patch.setattr(tasks, "send_event", lambda name, about: events.append(name))
        verdict = SimpleNamespace(effects=("spring",), robot="irb140")
        patch.setattr(tasks, "read_verdict", lambda *_: verdict)
        patch.setattr(tasks, "format_headline", lambda _: "a spring on joint 2")
        state = flows.nightly(return_state=True)
    return SimpleNamespace(folder=folder, state=state, order=order, events=events)


def test_a_night_has_a_seed_of_its_own_and_its_steps_in_order(night):
    assert night.state.result() == str(night.folder / "report.html")
    (name, given), *rest = night.order
    assert name == "run_campaign"
    # By the time at which it was due.
    assert given == ("examples/nightly.toml", str(night.folder), 20261122_020000)
    # Three analyses go on beside it.
    beside = ["identify", "calibrate", "validate"]
    assert sorted(n for n, _ in rest if n in beside) == sorted(beside)
    needed = ["resolve_adopted_model", "diagnose_stored_runs", "store_diagnosis_page"]
    needed += ["judge_adoption"]
    assert [name for name, _ in rest if name not in beside] == needed
    # The diagnosis goes by the model that the robot has.
    assert dict(rest)["diagnose_stored_runs"][0][2] == "11" * 10
    assert dict(rest)["validate"][0].run == "cc"  # what was held out is validated


def test_a_finding_is_told_once(night):
    assert night.events == ["modelgap.notice.finding"]


def test_a_night_is_called_by_its_verdict_and_leaves_few_artifacts(night):
    from prefect.artifacts import Artifact
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.filters import ArtifactFilter, ArtifactFilterFlowRunId

    id = night.state.state_details.flow_run_id
    own = ArtifactFilterFlowRunId(any_=[id])
    with get_client(sync_client=True) as client:
        left = client.read_artifacts(artifact_filter=ArtifactFilter(flow_run_id=own))
        assert client.read_flow_run(id).name == NAME
    keys = ["calibrate", "identify", "report", "validate", "verdict"]
    assert len(left) > len(keys)  # one was kept twice, as its answer was lost
    assert sorted({(a.key, a.data) for a in left}) == [
        (key, Artifact.get(key).data) for key in keys
    ]
    assert all(artifact.description for artifact in left)
    assert Artifact.get("report").description == NAME
    address = "http://127.0.0.1:4200/pages/"
    assert address in Artifact.get("report").data
    text = Artifact.get("verdict").data
    assert "a spring on joint 2" in text
    assert f"{address}index.html" in text
    table = "All of it.\n\n| model | J1 |\n| --- | --- |\n| ls | 1.0 |"
    stored = "Stored: `modelgap show ab`"
    assert Artifact.get("validate").data == f"{table}\n\n{stored}"


def test_each_experiment_is_a_task_run_and_a_lost_process_is_one_try(flows, tmp_path, monkeypatch):
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.filters import FlowRunFilter, FlowRunFilterId

    lost = []

    def run(spec, store, _):
        if spec.seed == 3 and not lost:
            lost.append(3)
            raise ChildProcessError("its process ended without a word")
        if spec.seed == 5:
            raise InputError("joint 2 at 1.2 s")
        id = compute_run_id(spec)
        build_record_path(store, "runs", id, "irb140").mkdir(parents=True)
        return id

    monkeypatch.setattr(campaign, "simulate_and_store", run)
    monkeypatch.setattr(flows, "ProcessExecutor", lambda _: InlineExecutor())
    monkeypatch.setattr(flows.tasks.experiment, "retry_delay_seconds", 0)
    (tmp_path / "C.toml").write_text(f"[grid]\nseed = {list(range(12))}\n")
    places = tmp_path / "C.toml", tmp_path / "store"
    state = flows.campaign(str(places[0]), store=str(places[1]), return_state=True)
    with pytest.raises(RunError, match="1 of 12 experiments failed"):
        state.result()
    own = FlowRunFilter(id=FlowRunFilterId(any_=[state.state_details.flow_run_id]))
    with get_client(sync_client=True) as client:

        def tries():
            rows = client.read_task_runs(flow_run_filter=own)
            final = all(row.state and row.state.is_final() for row in rows)
            return final and {row.name: (row.run_count, row.state_name) for row in rows}

        until(lambda: len(tries() or ()) == 12, "the server has heard of all")
        states = tries()
    assert states.pop("seed=3") == (2, "Completed")
    assert states.pop("seed=5") == (1, "Failed")
    assert set(states.values()) == {(1, "Completed")}
    assert len(list(places[1].glob("samples/*/*"))) == 11


@pytest.mark.long
def test_dask_makes_the_same_runs_with_the_same_bits(flows, tmp_path, monkeypatch, compiled_plant):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    path, stores = tmp_path / "C.toml", (tmp_path / "threads", tmp_path / "dask")
    path.write_text("[trajectory]\nduration = 2.0\n[grid]\nseed = [1, 2, 3]\n")
    ids = flows.campaign(str(path), store=str(stores[0]))
    monkeypatch.setenv(RUNNER, "dask")
    by_dask = flows.campaign.with_options(task_runner=flows.tasks.choose_task_runner())
    assert by_dask(str(path), store=str(stores[1])) == ids
    assert len(ids) == 3
    for id in ids:
        here, there = (read_channels(store, id) for store in stores)
        assert here.keys() == there.keys()
        assert all(np.array_equal(here[name], there[name]) for name in here)


def _deployments() -> list[dict]:
    return yaml.safe_load((ROOT / "prefect.yaml").read_text())["deployments"]


def test_a_store_verifies_itself_and_fails_where_it_is_damaged(flows, tmp_path):
    folder = tmp_path / "store"
    (folder / "quarantine").mkdir(parents=True)
    assert flows.verify(str(folder))[0] == "verified an empty store"
    (folder / "quarantine" / "run_id=aa.json").write_text('{"run_id": "bb"}')
    with pytest.raises(RunError, match="1 of 1 are damaged"):
        flows.verify(str(folder))


def test_every_deployment_names_a_flow_and_parameters_that_exist(server):
    from importlib import import_module

    names = [d["name"] for d in _deployments()]
    assert names == ["nightly", "monitor", "alarm", "propose", "campaign", "verify"]
    for deployment in _deployments():
        module, _, name = deployment["entrypoint"].rpartition(".")
        flow = getattr(import_module(module), name)
        known = set(flow.parameters.properties)
        own = deployment.get("parameters", {})
        assert flow.to_deployment("served", parameters=own).flow_name == flow.name
        more = [*deployment["schedules"], *deployment.get("triggers", [])]
        for given in (own, *(each.get("parameters", {}) for each in more)):
            assert set(given) <= known, deployment["name"]
            file = given.get("campaign_file")
            assert file is None or (ROOT / file).is_file()


def test_the_events_of_the_deployments_are_those_that_flows_send(server):
    from flows import project as deployments

    expected = {
        (d["name"], event, trigger["match"]["prefect.resource.id"])
        for d in _deployments()
        for trigger in d.get("triggers", ())
        for event in trigger["expect"]
    }
    assert expected == {
        ("monitor", deployments.COMMITTED, deployments.STORE),
        ("alarm", deployments.ALARM, deployments.STORE),
        ("propose", deployments.PROPOSED, deployments.STORE),
    }
