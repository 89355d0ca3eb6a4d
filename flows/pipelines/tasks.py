"""The tasks of the flows: steps with a name, a time limit, and retries.

To be imported under `flows.settings.build_prefect_environment`. Tasks take and return
ids, paths. Prefect caches nothing: the ids of the store are the cache. Artifacts and
events follow a commit; the store knows nothing of them.
"""

import os
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from itertools import chain
from pathlib import Path

from prefect import get_run_logger
from prefect import task as prefect_task
from prefect.artifacts import create_link_artifact, create_markdown_artifact
from prefect.cache_policies import NO_CACHE
from prefect.client.orchestration import get_client
from prefect.events import emit_event
from prefect.runtime import flow_run
from prefect.task_runners import TaskRunner, ThreadPoolTaskRunner

from flows import requests
from flows.inputs import read_run_robot
from flows.project import ALARM, COMMITTED, NOTICE, STORE
from flows.report import ReportTable, experiments, format_markdown_table, store_index
from flows.report.calibration import build_terminal_parts as calibrated_parts
from flows.report.experiments import build_alarm_table, describe_alarms
from flows.report.models import build_identification_parts as identified_parts
from flows.report.sentences import format_brief_claim, format_headline
from flows.report.store_index import INDEX, title_diagnosis
from flows.settings import HEALTHY, PAGES, build_page_address, count_cores, resolve_store_folder
from flows.steps import diagnose as diagnosis
from flows.steps import experiment as campaigns
from flows.steps import fit as fitting
from flows.steps import monitor as monitoring
from flows.steps import validate as validation
from flows.steps.experiment import PlannedExperiment
from flows.storage import read_verdict
from flows.workers import DASK, InlineExecutor, read_runner_setting, run_job
from residual.errors import RunError

_MOST = 200  # rows of a table
_TOGETHER = 1000  # ids in one event; the server refuses more than 1.5 MB
_LONGEST = 200  # characters of the name of a flow run


def publish_text(key: str, ids: Sequence[str], parts: Sequence[str | ReportTable]) -> None:
    """Show the outcome of a stage as one text, the same as its command prints."""
    stored = [f"Stored: {', '.join(f'`modelgap show {id}`' for id in ids)}"]
    texts = (p if isinstance(p, str) else format_markdown_table(p, _MOST) for p in parts)
    lines = [*texts, *(stored if ids else [])]
    about = next((part for part in parts if isinstance(part, str)), key)
    create_markdown_artifact("\n\n".join(lines), key, about)


def build_page_link(page: Path) -> str:
    """Return where a browser finds a page that is a file of a report."""
    return build_page_address(f"{page.parent.name}/{page.name}", page)


def send_runs_committed(ids: Sequence[str]) -> None:
    """Send the event that runs were stored; one event per batch."""
    for start in range(0, len(ids), _TOGETHER):
        send_event(COMMITTED, {"run_ids": list(ids[start : start + _TOGETHER])})


def send_event(name: str, payload: dict, about: str = STORE) -> None:
    """Send an event, which may start other flows."""
    emit_event(name, resource={"prefect.resource.id": about}, payload=payload)


def send_notice(
    kind: str, robot: str, title: str, text: str = "", ids: Sequence[str] = (), page: str = ""
) -> None:
    """Send an event for people, which [notify] of a project passes on to them.

    Args:
        kind: "alarm", "finding", "proposal", "refused" or "failed".
        title: In one line.
        text: All of it.
        ids: Ids of the records that it is about.
        page: Address of the page to look at, "" for none.
    """
    payload = {"kind": kind, "robot": robot, "title": title, "text": text}
    send_event(f"{NOTICE}.{kind}", payload | {"ids": list(ids), "page": page})


def format_run_name(diagnosis: str, store: Path) -> str:
    """Return a diagnosis in half a line: "irb140 #2: load friction on joint 2, ..."."""
    words = format_brief_claim(read_verdict(store, diagnosis))
    return f"{title_diagnosis(store, diagnosis)}: {words}"


def rename_flow_run(name: str) -> None:
    """Rename the current flow run, if there is one."""
    if flow_run.id is None:
        return
    with get_client(sync_client=True) as client:
        client.update_flow_run(flow_run.id, name=name[:_LONGEST])


HOUR = 3600.0  # s

task = partial(prefect_task, cache_policy=NO_CACHE, timeout_seconds=6 * HOUR)


def choose_task_runner() -> TaskRunner:
    """Return the task runner of flows: threads here, or Dask ($MODELGAP_RUNNER)."""
    address = read_runner_setting()
    if address is None:
        # Most of them wait: for a process, or for the server, which stalls at times.
        return ThreadPoolTaskRunner(max_workers=max(16, 4 * count_cores()))
    from prefect_dask import DaskTaskRunner

    if address != DASK:
        return DaskTaskRunner(address=address)
    cluster = {"n_workers": count_cores(), "threads_per_worker": 1, "host": "127.0.0.1"}
    return DaskTaskRunner(cluster_kwargs=cluster | {"dashboard_address": None})


def is_temporary_failure(_task: object, _run: object, state) -> bool:
    """Whether a retry may help: a process, disk or network failed.

    All else fails again, since a spec and its code decide it.
    """
    return isinstance(state.result(raise_on_failure=False), OSError)


# What is in the store is not run twice.
again = partial(
    task, retries=2, retry_delay_seconds=[10, 60], retry_condition_fn=is_temporary_failure
)


@again(name="experiment", task_run_name="{label}", tags=["simulation"])
def experiment(
    label: str, batch: list[PlannedExperiment], store: str, executor: Executor | None = None
) -> list[str]:
    """Run experiments of a campaign; return the ids of their runs.

    Args:
        executor: Processes of this machine; None on a cluster.
    """
    work = partial(campaigns.run_planned_experiment, store=store)
    futures = [(executor or InlineExecutor()).submit(run_job, work, each) for each in batch]
    ids = [future.result() for future in futures]
    for each, id in zip(batch, ids, strict=True):
        if why := campaigns.explain_missing_run(each, id, resolve_store_folder(store)):
            raise RunError(why)
    return ids


def identify(fit: list[str], held_out: list[str] | None = None, store: str | None = None) -> None:
    """Identify the parameters of an arm from runs."""
    place = resolve_store_folder(store)
    request = requests.Identify(
        tuple(fit), robot=read_run_robot(fit, place), held_out=tuple(held_out or ()), store=place
    )
    logs = fitting.read_identification_logs(request)
    outcome, kept = fitting.identify(request, logs)
    publish_text("identify", [kept] if kept else [], identified_parts(outcome))


def calibrate(runs: list[str], store: str | None = None) -> list[str]:
    """Fit look-up tables to runs; return the ids of the records."""
    place = resolve_store_folder(store)
    robot = read_run_robot(runs, place)
    request = requests.Calibrate(tuple(runs), robot=robot, store=place)
    done = fitting.calibrate(request, *fitting.read_calibration_runs(request))
    publish_text("calibrate", list(done.stored.values()), calibrated_parts(done))
    return list(done.stored.values())


def validate(runs: list[str], window: float = 0.25, store: str | None = None) -> list[str]:
    """Validate the nominal model on runs, in windows of some seconds; return the ids."""
    place = resolve_store_folder(store)
    queue = (requests.Validate(id, window, place) for id in runs)
    results = [(request.run, *validation.validate(request)) for request in queue]
    ids = [id for _, id, _ in results]
    parts = (experiments.build_validation_parts(run, made) for run, _, made in results)
    publish_text("validate", ids, [*chain.from_iterable(parts)])
    return ids


@task(name="diagnose", task_run_name="diagnose", tags=["analysis"])
def diagnose(runs: dict, store: str, model: str | None = None) -> list[str]:
    """Diagnose runs and store the verdict."""
    request = diagnosis.build_diagnose_request(runs, Path(store), model)
    return list(diagnosis.diagnose_stored_runs(request))


@task(name="watch", task_run_name="watch", tags=["monitoring"])
def watch(
    ids: list[str], model: str | None, good: list[str], store: str, tag: str = HEALTHY
) -> list[str]:
    """Monitor the sensors of runs; an alarm sends an event."""
    new = monitoring.monitor_new_runs(ids, Path(store), model, good, tag)
    if new.record is None or new.result is None:
        get_run_logger().info(new.why)
        publish_text("monitor", (), [f"{new.why} Nothing was monitored."])
        rename_flow_run(f"monitor: nothing monitored. {new.why}")
        return []
    parts = [
        describe_alarms(new.result),
        *new.result.notes,
        build_alarm_table(new.result, new.watched),
    ]
    publish_text("monitor", [new.record], parts)
    alarmed, count = new.alarmed, len(new.watched)
    summary = f"alarms in {len(alarmed)} of" if alarmed else "no alarm in"
    robot = new.result.monitor.model.robot.name
    rename_flow_run(f"{robot}: {summary} {count} new runs")
    if alarmed:
        good = {"good_ids": list(new.result.calibration)}
        send_event(ALARM, {"record": new.record, "run_ids": list(alarmed)} | good)
        title = f"{robot}: {summary} {count} new runs"
        send_notice("alarm", robot, title, describe_alarms(new.result), list(alarmed))
    return [new.record]


@task(name="report", task_run_name="report {ids[0]}", tags=["report"])
def report(ids: list[str], store: str) -> str:
    """Write the report, send a notice of its findings; return its page.

    It and the sentences of the verdict become artifacts.
    """
    page = store_index.store_diagnosis_page(ids, Path(store), "nightly")
    name, verdict = format_run_name(ids[0], Path(store)), read_verdict(Path(store), ids[0])
    link = build_page_link(page)
    create_link_artifact(link, "report", key="report", description=name)
    lines = [f"**{name}**", format_headline(verdict), f"[Report]({link})"]
    if os.environ.get(PAGES):
        lines[-1] += f" · [All reports]({build_page_address(INDEX, page)})"
    create_markdown_artifact("\n\n".join(lines), "verdict", description=name)
    rename_flow_run(name)
    if verdict.effects:
        title = f"{verdict.robot}: {format_headline(verdict)}"
        send_notice("finding", verdict.robot, title, ids=ids[:1], page=link)
    return str(page)
