"""The night closes the loop: it proposes or adopts, and the next finds nothing."""

import os
import sys
from pathlib import Path

import pytest

from flows.service.state import KEY, RunningService, start_process, stop_process, write_running
from flows.settings import prefect_home
from flows.steps.model_choice import judge_adoption, list_adoptions, roll_back
from tests.flows.adopted_arm import ROBOT, SERIAL
from warehouse.record_commit import commit_adoption
from warehouse.store_catalogue import ADOPTED, ModelAdoption, find_last_adoption, read_record

SLEEP = [sys.executable, "-c", "import time; time.sleep(600)"]

pytestmark = [pytest.mark.prefect, pytest.mark.slow]


@pytest.fixture(scope="module")
def night_store(arm_nights):
    return arm_nights.store, arm_nights.first, arm_nights.id


@pytest.fixture
def nights(server, night_store, monkeypatch):
    from flows.pipelines import flows as pipelines

    events = []
    monkeypatch.setattr(
        pipelines.tasks,
        "send_event",
        lambda event, about: events.append((event, *about.get("ids", about.values()))),
    )
    yield pipelines, night_store, events
    store = night_store[0]
    while (last := find_last_adoption(store, ROBOT, SERIAL)) and last[1].model_id:
        roll_back(f"{ROBOT} {SERIAL}", store=store)


def in_a_flow(task, *given):
    from prefect import flow

    return flow(lambda: task(*given), name="night")()


def test_what_passes_the_gate_is_proposed_once_and_nothing_is_adopted(nights):
    tasks, (store, _, id), events = nights
    page = in_a_flow(tasks.adopt_or_propose, id, str(store), False)
    assert "Comparison" in Path(page).read_text(encoding="utf-8")
    told = [("modelgap.model.proposed", id), ("modelgap.notice.proposal", id)]
    assert events == told
    assert (
        find_last_adoption(store, ROBOT, SERIAL) is None
        or find_last_adoption(store, ROBOT, SERIAL)[1].model_id is None
    )
    # The same finding of another night, unanswered as yet, is no new proposal.
    assert in_a_flow(tasks.adopt_or_propose, id, str(store), False) is None
    assert events == told


def test_auto_adopts_and_the_next_night_finds_nothing_to_propose(nights, arm_nights):
    tasks, (store, _, id), events = nights
    number = in_a_flow(tasks.adopt_or_propose, id, str(store), True)
    assert find_last_adoption(store, ROBOT, SERIAL)[0] == number
    fit = {"fit": list(arm_nights.second[0])}
    assert in_a_flow(tasks.find_adopted_model, fit, str(store)) == id
    again = arm_nights.again
    assert judge_adoption(store, again).doubts[0] == "it names no missing effect"
    before = len(list_adoptions(store))
    assert in_a_flow(tasks.adopt_or_propose, again, str(store), True) is None
    assert (len(list_adoptions(store)), events) == (before, [])


@pytest.fixture
def waiting(server, nights, monkeypatch):
    """Two suspended proposals at the server of the store: of its diagnosis, of none."""
    from prefect import get_client
    from prefect.client.schemas.objects import State, StateType

    tasks, (store, _, id), _ = nights
    in_a_flow(tasks.adopt_or_propose, id, str(store), False)
    host, _, port = server.url.removesuffix("/api").rpartition("//")[2].partition(":")
    home = prefect_home(store)
    (home / KEY).write_text(f"{server.key}\n")
    (home / KEY).chmod(0o600)
    write_running(home, RunningService(host, int(port), "sqlite"))
    start_process(home, "server", SLEEP, os.environ)
    with get_client(sync_client=True) as client:
        place = client.create_deployment(client.create_flow(tasks.propose), "propose-of-a-test")
        runs = []
        for diagnosis in (id, "ab" * 10):
            run = client.create_flow_run_from_deployment(place, parameters={"diagnosis": diagnosis})
            state = State(type=StateType.PAUSED, name="Suspended")
            client.set_flow_run_state(run.id, state, force=True)
            runs.append(run.id)
        yield lambda: [client.read_flow_run(run).state for run in runs]
    stop_process(home, "server", grace=1.0)


def test_a_proposal_that_was_settled_by_the_command_waits_no_longer(
    nights, waiting, cli, monkeypatch
):
    from prefect import get_client

    from flows.pipelines import cancel_settled_proposals

    monkeypatch.setattr("flows.cli.service._prepare", lambda home: None)
    _, (store, _, id), _ = nights
    model = read_record(store, id)["model_id"]
    # An arm without a number is another one than that of the proposal.
    without = ModelAdoption(ROBOT, None, ADOPTED, model, id, None, "ann")
    commit_adoption(store, without)
    with get_client(sync_client=True) as client:
        assert cancel_settled_proposals(client, store) == 0
    assert [state.name for state in waiting()] == ["Suspended", "Suspended"]
    code, out, err = cli("adopt", id, "--note", "seen", "--store", str(store))
    assert (code, err) == (0, ""), out
    settled, other = waiting()
    number = int(find_last_adoption(store, ROBOT, SERIAL)[0])
    assert (settled.name, other.name) == ("Cancelled", "Suspended")
    assert f"Settled by adoption {number} of {ROBOT} (adopted by" in settled.message
    assert settled.message.endswith(": seen).")


def test_an_answer_that_comes_too_late_is_told_and_is_no_failure(nights):
    tasks, (store, _, id), _ = nights
    number = in_a_flow(tasks.adopt, id, str(store), "looked at it")
    assert find_last_adoption(store, ROBOT, SERIAL)[0] == number
    assert find_last_adoption(store, ROBOT, SERIAL)[1].note == "looked at it"
    assert in_a_flow(tasks.adopt, id, str(store), "once more") is None
