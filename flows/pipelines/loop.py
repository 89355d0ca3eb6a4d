"""The flow propose, and the tasks that adopt or propose a model.

To be imported under `flows.settings.quiet_prefect`.
"""

from pathlib import Path

from prefect import flow, get_run_logger
from prefect.flow_runs import suspend_flow_run
from prefect.input import RunInput

from flows.pipelines import tasks
from flows.pipelines.tasks import task
from flows.project.deployments import PROPOSED
from flows.report.index import write_index
from flows.report.models import adoption_lines, proposal_markdown, proposal_page
from flows.report.page import origin_of_record
from flows.settings import store_folder
from flows.steps.adopt import Adopt, Proposal, judge, keep_proposal, known_already
from flows.steps.adopt import adopt as give
from flows.steps.models import in_force
from flows.storage.diagnosis import read_verdict
from residual.errors import InputError


@task(name="model-in-force", task_run_name="model-in-force", tags=["analysis"])
def model_in_force(runs: dict, store: str) -> str | None:
    """Return the id of the diagnosis of the adopted model, and log it."""
    choice = in_force(runs["fit"], Path(store))
    get_run_logger().info(choice.line or "model: the nominal one")
    return choice.diagnosis


@task(name="adopt-or-propose", task_run_name="adopt-or-propose", tags=["analysis"])
def adopt_or_propose(diagnosis: str, store: str, auto: bool) -> str | None:
    """Adopt or propose the model of a diagnosis; return the adoption or the page."""
    place, log = Path(store), get_run_logger()
    judgment = judge(place, diagnosis)
    if judgment.doubts:
        say = log.warning if read_verdict(place, diagnosis).effects else log.info
        say(f"nothing to propose: {'; '.join(judgment.doubts)}")
        return None
    if auto:
        return _adopt(diagnosis, place, "found by a night, adopted by itself")
    proposal = Proposal(judgment, read_verdict(place, judgment.diagnosis))
    before = known_already(place, proposal)
    if before:
        log.info(f"proposed already: modelgap show {before}")
        return None
    sources = origin_of_record(place, diagnosis)
    page = keep_proposal(place, proposal, proposal_page(proposal, sources).encode())
    write_index(place)
    about = f"a new model waits for a decision: diagnosis {diagnosis}"
    text = proposal_markdown(proposal)
    tasks.publish_link("proposal", page, text, "Side by side", about)
    tasks.send_event(PROPOSED, {"diagnosis": diagnosis})
    return str(page)


def question(diagnosis: str, store: str) -> str:
    """Return a proposal as Markdown, with the current judgment of the gate."""
    place = Path(store)
    judgment = judge(place, diagnosis)
    return proposal_markdown(
        Proposal(judgment, read_verdict(place, judgment.diagnosis))
    )


@task(name="adopt", task_run_name="adopt {diagnosis}", tags=["analysis"])
def adopt(diagnosis: str, store: str, note: str) -> str | None:
    """Adopt a proposed model; a refusal is logged and is no failure."""
    try:
        return _adopt(diagnosis, Path(store), note)
    except InputError as error:
        get_run_logger().warning(str(error))
        tasks.publish("adoption", (), [str(error)])
        return None


def _adopt(diagnosis: str, store: Path, note: str) -> str:
    number, judgment = give(Adopt(diagnosis, note, store=store))
    lines = adoption_lines(number, judgment)
    for line in lines:
        get_run_logger().info(line)
    tasks.publish("adoption", (diagnosis,), lines)
    return number


class Answer(RunInput):
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
    place = str(store_folder(store))
    question_form = Answer.with_initial_data(
        description=question(diagnosis, place), adopt=False, note=""
    )
    answer = suspend_flow_run(wait_for_input=question_form, timeout=None, key="adopt")
    if not answer.adopt:
        get_run_logger().info("not adopted: that was the answer")
        return None
    return adopt(diagnosis, place, answer.note)
