"""The flows: nightly, campaign, monitor, verify, inbox, diagnose-new and propose.

To be imported under `flows.settings.build_prefect_environment`. prefect.yaml and
`flows.project` say when each starts, `$MODELGAP_RUNNER` where their tasks run.
`store` is a folder; None is $MODELGAP_STORE, else ./store.
"""

from collections import Counter
from contextlib import nullcontext
from functools import partial
from pathlib import Path

from prefect import flow, get_run_logger
from prefect.artifacts import create_markdown_artifact
from prefect.client.orchestration import get_client
from prefect.flow_runs import suspend_flow_run
from prefect.input import RunInput
from prefect.runtime import flow_run

from flows.pipelines import cancel_settled_proposals, tasks
from flows.pipelines.tasks import task
from flows.project import PROPOSED, build_robot_resource, read_project
from flows.project import STORED as ARRIVED
from flows.report import build_text_table
from flows.report.models import describe_adoption, render_proposal_markdown, render_proposal_page
from flows.report.page import read_record_origin
from flows.report.store_index import write_index
from flows.settings import HEALTHY, count_cores, resolve_store_folder
from flows.steps import experiment as campaigns
from flows.steps import monitor as monitoring
from flows.steps import rerun as verification
from flows.steps.inbox import (
    KNOWN,
    REFUSED,
    STORED,
    WAITING,
    find_new_runs,
    find_project_robot,
    import_inbox_logs,
    list_inboxes,
    wait_for_unchanged_logs,
)
from flows.steps.inbox import diagnose_new_runs as diagnose_runs
from flows.steps.model_choice import adopt as give
from flows.steps.model_choice import find_same_proposal, judge_adoption, resolve_adopted_model
from flows.steps.monitor import find_diagnosis, find_healthy_runs
from flows.storage import store_report
from flows.workers import ProcessExecutor, read_runner_setting
from residual import one_blas_thread
from residual.errors import InputError, RunError


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
        say = log.warning if judgment.verdict.effects else log.info
        say(f"nothing to propose: {'; '.join(judgment.doubts)}")
        return None
    if auto:
        return _adopt(diagnosis, place, "found and adopted by a scheduled run")
    if before := find_same_proposal(place, judgment):
        log.info(f"proposed already: modelgap show {before}")
        return None
    sources = read_record_origin(place, diagnosis)
    files = {"proposal.html": render_proposal_page(judgment, sources).encode()}
    folder = store_report(place, judgment.proposal, judgment.diagnosis, files)
    page = folder / "proposal.html"
    write_index(place)
    about = f"a new model waits for a decision: diagnosis {diagnosis}"
    text = render_proposal_markdown(judgment)
    robot, link = judgment.verdict.robot, tasks.build_page_link(page)
    text += f"\n\n[Side by side]({link})"
    create_markdown_artifact(text, "proposal", about)
    tasks.send_event(PROPOSED, {"diagnosis": diagnosis})
    title = f"{robot}: {about}"
    tasks.send_notice("proposal", robot, title, ids=[diagnosis], page=link)
    return str(page)


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
    place = resolve_store_folder(store)
    description = render_proposal_markdown(judge_adoption(place, diagnosis))
    question_form = ProposalAnswer.with_initial_data(description=description, adopt=False, note="")
    answer = suspend_flow_run(wait_for_input=question_form, timeout=None, key="adopt")
    if not answer.adopt:
        get_run_logger().info("not adopted, as answered")
        return None
    return adopt(diagnosis, str(place), answer.note)


_LIMIT = 12 * tasks.HOUR
_NIGHT = 24 * tasks.HOUR
_MOST = 200  # task runs of one campaign; of more experiments each has some
_analysis = partial(tasks.task, tags=["analysis"])
_identify, _calibrate, _validate = (
    _analysis(step, task_run_name=step.__name__)
    for step in (tasks.identify, tasks.calibrate, tasks.validate)
)
_distributed = partial(flow, timeout_seconds=_NIGHT, task_runner=tasks.choose_task_runner())


@_distributed(name="nightly", flow_run_name="nightly {campaign_file}")
@one_blas_thread
def nightly(
    campaign_file: str = "examples/nightly.toml",
    held_out: str = "welding",
    store: str | None = None,
    auto: bool = False,
    seed: int | None = None,
) -> str:
    """Run new motions; identify, calibrate, validate, diagnose, report.

    Proposes the model of the diagnosis if it differs from the adopted one; the flow
    `propose` waits for the answer. The other analyses run in parallel with the
    diagnosis.

    Args:
        campaign_file: The campaign.
        held_out: Kind of motion that is not fitted.
        auto: Adopt the model without asking.
        seed: Seed of the motions instead of that of the campaign; by default the
            scheduled time, such as 20261122020000. Every run stores it.
    """
    place = str(resolve_store_folder(store))
    if seed is None:
        seed = int(f"{flow_run.scheduled_start_time:%Y%m%d%H%M%S}")
    get_run_logger().info(f"to repeat this night: seed {seed}")
    summary = run_campaign(campaign_file, place, seed)
    runs = campaigns.group_runs_by_role(campaign_file, held_out, summary)
    fit, proof = runs["fit"], runs["held_out"]
    beside = [
        _identify.submit(fit, proof, place),
        _calibrate.submit([*fit, *proof], place),
        _validate.submit(proof or fit, store=place),
    ]
    ids = tasks.diagnose(runs, place, find_adopted_model(runs, place))
    page = tasks.report(ids, place)
    adopt_or_propose(ids[0], place, auto)
    for future in beside:
        future.result()
    return page


@_distributed(name="campaign", flow_run_name="campaign {campaign_file}")
def campaign(campaign_file: str, seed: int | None = None, store: str | None = None) -> list[str]:
    """Run the missing experiments of a campaign, each as a task; return all run ids.

    Raises:
        RunError: If some failed; the others are stored.
    """
    summary = run_campaign(campaign_file, str(resolve_store_folder(store)), seed)
    if summary.failed:
        raise RunError(campaigns.advise_on_failures(summary))
    return list(summary.stored)


def run_campaign(path: str, place: str, seed: int | None) -> campaigns.CampaignSummary:
    """Submit the missing experiments; a failure stops no other."""
    log, store = get_run_logger(), resolve_store_folder(place)
    planned = campaigns.plan_campaign(path, store, seed)
    missing = [each for each in planned if not each.stored]
    log.info(f"{len(missing)} to run, {len(planned) - len(missing)} in {place}")
    campaigns.store_campaign(planned, path, store)
    size = -(-len(missing) // _MOST) or 1
    batches = [missing[k : k + size] for k in range(0, len(missing), size)]
    failed: dict[str, str] = {}
    # A server that gets all task runs at once has no time for those that run.
    ahead = 4 * count_cores()
    with (
        ProcessExecutor(count_cores())
        if read_runner_setting() is None
        else nullcontext() as executor
    ):
        futures = []
        for batch in batches:
            more = f" and {len(batch) - 1} more" if len(batch) > 1 else ""
            label = f"{batch[0].label}{more}"
            if executor and len(futures) >= ahead:
                futures[-ahead].wait()
            futures.append(tasks.experiment.submit(label, batch, place, executor))
        for batch, future in zip(batches, futures, strict=True):
            outcome = future.result(raise_on_failure=False)
            if isinstance(outcome, BaseException):
                failed |= campaigns.explain_failures(batch, outcome, store)
    for why in failed.values():
        log.warning(why)
    summary = campaigns.CampaignSummary(tuple(planned), failed)
    tasks.send_runs_committed(summary.new)
    return summary


@flow(name="monitor", flow_run_name="monitor", timeout_seconds=_LIMIT)
def monitor(
    runs: list[str],
    model: str | None = None,
    good: list[str] | None = None,
    store: str | None = None,
    project: str | None = None,
) -> list[str]:
    """Monitor the sensors of new runs; an alarm starts a diagnosis.

    Args:
        runs: Ids of the runs.
        model: Id of a diagnosis, or a robot; by default the latest diagnosis.
        good: Ids of healthy runs; by default those with the tag of healthy runs, or if
            these are too few the runs of the diagnosis.
        project: Folder of the project that sets that tag.

    Returns:
        The id of the record; none if there was nothing to compare with.
    """
    table = find_project_robot(read_project(project), runs) if project else None
    tag = table.healthy if table else HEALTHY
    place = resolve_store_folder(store)
    arms = monitoring.group_runs_by_arm(runs, place)
    watched = (tasks.watch(arm, model, good or [], str(place), tag) for arm in arms)
    return [record for records in watched for record in records]


@flow(name="verify", flow_run_name="verify", timeout_seconds=_LIMIT)
def verify(store: str | None = None) -> list[str]:
    """Check every byte of the store; return its summary, or fail."""
    log, out = get_run_logger(), []
    for line in verification.find_damaged_files(resolve_store_folder(store)):
        log.info(line)
        out.append(line)
    return out


_KINDS = (STORED, KNOWN, REFUSED, WAITING)


@task(name="inbox", task_run_name="inbox", tags=["logs"])
def take(folder: str) -> dict:
    """Import the logs in the inboxes of a project, and send the events."""
    project, log = read_project(folder), get_run_logger()
    of, sums, rows, fed = list_inboxes(project), Counter(), [], set()
    for place, resting in wait_for_unchanged_logs(of).items():
        robot = of[place].table.robot
        for taken in import_inbox_logs(of[place], resting, tasks.send_runs_committed):
            sums[taken.status] += 1
            outcome = taken.run or taken.why
            log.info(f"{taken.name}: {taken.status}: {outcome}")
            rows.append((taken.name, taken.status, outcome))
            if taken.run:
                fed.add(robot)
            if taken.status == REFUSED:
                title = f"{robot}: {taken.name} was refused"
                tasks.send_notice("refused", robot, title, taken.why)
    for robot in fed:
        tasks.send_event(ARRIVED, {"robot": robot}, build_robot_resource(robot))
    words = ", ".join(f"{sums[kind]} {kind}" for kind in _KINDS if sums[kind])
    if rows:
        table = build_text_table(("log", "outcome", "run or reason"), rows)
        tasks.publish_text("inbox", (), [f"Logs of the inboxes: {words}.", table])
    tasks.rename_flow_run(f"inbox: {words or 'empty'}")
    return {kind: sums[kind] for kind in _KINDS}


@task(name="diagnose", task_run_name="diagnose", tags=["analysis"])
def diagnose(folder: str, robot: str) -> list[str]:
    """Monitor and diagnose the new runs of a robot; return the ids of the records."""
    project = read_project(folder)
    table = project.robot(robot)
    try:
        batch = find_new_runs(project.store, project.arm(table), table)
        # The server may have been killed before their event started the monitoring.
        if batch and batch.unwatched:
            runs, store = list(batch.unwatched), str(project.store)
            tasks.watch(runs, None, [], store, table.healthy)
            tasks.rename_flow_run(f"{robot}: {len(batch.runs)} new runs")
        outcome = diagnose_runs(project, robot)
    except InputError as error:
        tasks.rename_flow_run(f"{robot}: not diagnosed")
        tasks.send_notice("failed", robot, f"{robot}: not diagnosed", str(error))
        raise
    if outcome is None:
        tasks.rename_flow_run(f"{robot}: no new runs")
        get_run_logger().info("no new runs")
        return []
    count, against = len(outcome.batch.runs), outcome.batch.against
    get_run_logger().info(f"{count} new runs against {against}")
    return list(outcome.ids)


@flow(name="inbox", flow_run_name="inbox", timeout_seconds=_LIMIT)
def inbox(project: str) -> dict:
    """Check and import the logs in the inboxes of a project; return their counts.

    Events start the flows `monitor` and, if the project sets `batch`, `diagnose-new`.
    """
    return take(project)


@flow(name="diagnose-new", timeout_seconds=_LIMIT)
def diagnose_new(
    project: str | None = None,
    robot: str | None = None,
    runs: list[str] | None = None,
    good: list[str] | None = None,
    store: str | None = None,
) -> str | None:
    """Diagnose the new runs of a real robot, or runs with an alarm; return the report.

    Runs with an alarm are diagnosed with all new runs of their robot in the project;
    without a project once, against the healthy runs.

    Args:
        project: Folder of the project.
        robot: Name of the robot in it.
        runs: Ids of runs with an alarm, instead of a robot.
        good: Ids of healthy runs of the arm.
    """
    if project and runs and (table := find_project_robot(read_project(project), runs)):
        robot = table.name
    if project and robot:
        tasks.rename_flow_run(robot)
        ids, read = diagnose(project, robot), read_project(project)
        if not ids:
            return None
        page = tasks.report(ids, str(read.store))
        adopt_or_propose(ids[0], str(read.store), read.robot(robot).auto)
        return page
    if not runs:
        raise InputError("diagnose-new needs a project with its robot, or runs.")
    place = resolve_store_folder(store)
    if known := find_diagnosis(runs, place):
        name = tasks.format_run_name(known, place)
        tasks.rename_flow_run(f"already diagnosed: {name}")
        get_run_logger().info(f"diagnosis {known} has these runs")
        return None
    healthy = find_healthy_runs(runs, place)
    healthy = healthy or [run for run in good or [] if run not in runs]
    roles = {"fit": runs, "held_out": [], "baseline": list(healthy)}
    return tasks.report(tasks.diagnose(roles, str(place)), str(place))
