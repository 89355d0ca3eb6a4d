"""The flow that asks: suspended without a process, resumed with an answer."""

import pytest

pytestmark = pytest.mark.prefect


@pytest.fixture
def flow_run(server, monkeypatch, tmp_path):
    """A flow run of a deployment, as an event starts it; and what was adopted."""
    from prefect import get_client
    from prefect.exceptions import Pause
    from prefect.flow_engine import run_flow

    from flows.pipelines import flows as pipelines

    given = []
    monkeypatch.setattr(pipelines, "judge_adoption", lambda *_: None)
    monkeypatch.setattr(pipelines, "render_proposal_markdown", lambda _: "| now | then |")
    monkeypatch.setattr(pipelines, "adopt", lambda *it: given.append(it) or "7")
    words = {"diagnosis": "ab" * 10, "store": str(tmp_path)}
    with get_client(sync_client=True) as client:
        place = client.create_deployment(client.create_flow(pipelines.propose), "propose")
        run = client.create_flow_run_from_deployment(place, parameters=words)

        def go():
            now = client.read_flow_run(run.id)
            try:
                return run_flow(
                    pipelines.propose, flow_run=now, parameters=words, return_type="state"
                )
            except Pause as suspended:  # so its process ends
                return suspended.state

        yield run.id, go, given


def answered(run, **answer):
    from prefect.flow_runs import resume_flow_run

    resume_flow_run(run, run_input=answer)


@pytest.mark.parametrize(("yes", "note"), [(True, "looked at it"), (False, "")])
def test_yes_adopts_with_the_note_of_who_answered_and_no_ends_it(flow_run, yes, note):
    run, go, given = flow_run
    state = go()
    assert (state.type.value, state.name) == ("PAUSED", "Suspended")
    assert state.state_details.run_input_keyset
    assert given == []
    answered(run, adopt=yes, note=note)
    assert go().type.value == "COMPLETED"
    assert [(diagnosis, said) for diagnosis, _, said in given] == (
        [("ab" * 10, note)] if yes else []
    )
