"""The flow propose, and the tasks that adopt or propose a model.

To be imported under `flows.settings.build_prefect_environment`.
"""

from pathlib import Path

from prefect import flow, get_run_logger
from prefect.artifacts import create_markdown_artifact
from prefect.client.orchestration import get_client
from prefect.flow_runs import suspend_flow_run
from prefect.input import RunInput

from flows.pipelines import tasks
from flows.pipelines.proposals import cancel_settled_proposals
from flows.pipelines.tasks import task
from flows.project.deployments import PROPOSED
from flows.report.models import describe_adoption, render_proposal_markdown, render_proposal_page
from flows.report.page import read_record_origin
from flows.report.store_index import write_index
from flows.settings import resolve_store_folder
from flows.steps.adopt import Proposal, find_same_proposal, judge_adoption, store_proposal
from flows.steps.adopt import adopt as give
from flows.steps.model_choice import resolve_adopted_model
from flows.storage.diagnosis import read_verdict
from residual.errors import InputError


@task(name="model-in-force", task_run_name="model-in-force", tags=["analysis"])
def find_adopted_model(runs: dict, store: str) -> str | None:
    """Return the id of the diagnosis of the adopted model, and log it."""
    choice = resolve_adopted_model(runs["fit"], Path(store))
    get_run_logger().info(choice.line or "model: the nominal one")
    return choice.diagnosis


@task(name="adopt-or-propose", task_run_name="adopt-or-propose", tags=["analysis"])
def adopt_or_propose(diagnosis: str, store: str, auto: bool) -> str | None:
    """Adopt or propose the model of a diagnosis; return the adoption or the page."""
    place, log = Path(store), get_run_logger()
    judgment = judge_adoption(place, diagnosis)
    if judgment.doubts:
        say = log.warning if read_verdict(place, diagnosis).effects else log.info
        say(f"nothing to propose: {'; '.join(judgment.doubts)}")
        return None
    if auto:
        return _adopt(diagnosis, place, "found by a night, adopted by itself")
    proposal = Proposal(judgment, read_verdict(place, judgment.diagnosis))
    before = find_same_proposal(place, proposal)
    if before:
        log.info(f"proposed already: modelgap show {before}")
        return None
    sources = read_record_origin(place, diagnosis)
    page = store_proposal(place, proposal, render_proposal_page(proposal, sources).encode())
    write_index(place)
    about = f"a new model waits for a decision: diagnosis {diagnosis}"
    text = render_proposal_markdown(proposal)
    robot, link = proposal.verdict.robot, tasks.build_page_link(page)
    text += f"\n\n[Side by side]({link})"
    create_markdown_artifact(text, "proposal", about)
    tasks.send_event(PROPOSED, {"diagnosis": diagnosis})
    title = f"{robot}: {about}"
    tasks.send_notice("proposal", robot, title, ids=[diagnosis], page=link)
    return str(page)


def render_proposal(diagnosis: str, store: str) -> str:
    """Return a proposal as Markdown, with the current judgment of the gate."""
    place = Path(store)
    judgment = judge_adoption(place, diagnosis)
    return render_proposal_markdown(Proposal(judgment, read_verdict(place, judgment.diagnosis)))


@task(name="adopt", task_run_name="adopt {diagnosis}", tags=["analysis"])
def adopt(diagnosis: str, store: str, note: str) -> str | None:
    """Adopt a proposed model; a refusal is logged and is no failure."""
    try:
        return _adopt(diagnosis, Path(store), note)
    except InputError as error:
        get_run_logger().warning(str(error))
        tasks.publish_text("adoption", (), [str(error)])
        return None


def _adopt(diagnosis: str, store: Path, note: str) -> str:
    number, judgment = give(diagnosis, note, store=store)
    lines = describe_adoption(number, judgment)
    for line in lines:
        get_run_logger().info(line)
    tasks.publish_text("adoption", (diagnosis,), lines)
    # This may have settled other proposals of the robot.
    with get_client(sync_client=True) as client:
        cancel_settled_proposals(client, store)
    return number


class ProposalAnswer(RunInput):
    """The answer to a proposal: whether to adopt the model, and a note."""

    adopt: bool = False
    note: str = ""


@flow(name="propose", flow_run_name="propose {diagnosis}")
def propose(diagnosis: str, store: str | None = None) -> str | None:
    """Ask whether to adopt the model of a diagnosis.

    The run is suspended, without a process, until it is resumed with an answer; then it
    starts again with the answer.

    Args:
        diagnosis: Its id.

    Returns:
        The number of the adoption, None where the answer was no.
    """
    place = str(resolve_store_folder(store))
    question_form = ProposalAnswer.with_initial_data(
        description=render_proposal(diagnosis, place), adopt=False, note=""
    )
    answer = suspend_flow_run(wait_for_input=question_form, timeout=None, key="adopt")
    if not answer.adopt:
        get_run_logger().info("not adopted: that was the answer")
        return None
    return adopt(diagnosis, place, answer.note)
