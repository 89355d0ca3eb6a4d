"""The night closes the loop: it proposes or adopts, and the next finds nothing."""

from pathlib import Path

import pytest

from flows.report.models import render_proposal_markdown, render_proposal_page
from flows.steps.adopt import Proposal, judge_adoption, list_adoptions, roll_back
from flows.storage.diagnosis import read_verdict
from tests.flows.adopted_arm import ROBOT, SERIAL
from warehouse.record_commit import find_last_adoption

pytestmark = [pytest.mark.prefect, pytest.mark.slow]


@pytest.fixture(scope="module")
def night_store(arm_nights):
    return arm_nights.store, arm_nights.first, arm_nights.id


@pytest.fixture
def nights(server, night_store, monkeypatch):
    from flows.pipelines import adoption_flow

    events = []
    monkeypatch.setattr(
        adoption_flow.tasks,
        "send_event",
        lambda event, about: events.append(about["diagnosis"]),
    )
    yield adoption_flow, night_store, events
    store = night_store[0]
    while (last := find_last_adoption(store, ROBOT, SERIAL)) and last[1].model_id:
        roll_back(None, store=store)


def in_a_flow(task, *given):
    from prefect import flow

    return flow(lambda: task(*given), name="night")()


def test_what_passes_the_gate_is_proposed_once_and_nothing_is_adopted(nights):
    tasks, (store, _, id), events = nights
    page = in_a_flow(tasks.adopt_or_propose, id, str(store), False)
    assert "Comparison" in Path(page).read_text(encoding="utf-8")
    assert events == [id]
    assert (
        find_last_adoption(store, ROBOT, SERIAL) is None
        or find_last_adoption(store, ROBOT, SERIAL)[1].model_id is None
    )
    # The same finding of another night, unanswered as yet, is no new proposal.
    assert in_a_flow(tasks.adopt_or_propose, id, str(store), False) is None
    assert events == [id]


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


def test_an_answer_that_comes_too_late_is_told_and_is_no_failure(nights):
    tasks, (store, _, id), _ = nights
    number = in_a_flow(tasks.adopt, id, str(store), "looked at it")
    assert find_last_adoption(store, ROBOT, SERIAL)[0] == number
    assert find_last_adoption(store, ROBOT, SERIAL)[1].note == "looked at it"
    assert in_a_flow(tasks.adopt, id, str(store), "once more") is None


def test_both_models_stand_side_by_side_on_the_page_and_in_the_question(night_store):
    store, _, id = night_store
    proposal = Proposal(judge_adoption(store, id), read_verdict(store, id))
    for text in (render_proposal_page(proposal), render_proposal_markdown(proposal)):
        assert "nominal model" in text
        assert "spring on joint 2: stiffness" in text
        assert "confirmed at 1.0" in text or "confirmed at 0.9" in text
    assert f"modelgap adopt {id}" in render_proposal_page(proposal)
