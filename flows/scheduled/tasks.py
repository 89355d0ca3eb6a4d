"""All Prefect tasks: plain steps with a name, a time limit, and retries where due.

To be imported after `flows.settings.prepare_prefect`. Ids and paths go in and out; what
people want to see becomes an artifact. Prefect caches nothing: the ids of the store are
the cache.
"""

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

from prefect import get_run_logger
from prefect import task as prefect_task
from prefect.cache_policies import NO_CACHE

from flows import requests
from flows.blind import run as blind_run
from flows.blind.draw import Asked
from flows.inputs.robots import robot_of
from flows.report import stored
from flows.report.study import headline, lines, store_page
from flows.scheduled import artifacts, events, names
from flows.scheduled.surroundings import surroundings
from flows.specs.experiment import load_spec
from flows.steps import calibrate as calibration
from flows.steps import campaign as campaigns
from flows.steps import demo
from flows.steps import diagnose as diagnosis
from flows.steps import experiment as experiments
from flows.steps import identify as identification
from flows.steps import monitor as monitoring
from flows.steps import validate as validation
from flows.steps import verify as verification
from flows.steps.loop.choose import in_force
from flows.steps.monitor_model import source_of
from flows.steps.rerun import rerun as reruns
from flows.workers.runner import ClusterLostError
from residual.monitoring.monitor import LEAST_RUNS
from sim.records import CLEAN, BackgroundWord

HOUR = 3600.0  # s

task = partial(prefect_task, cache_policy=NO_CACHE, timeout_seconds=6 * HOUR)


def outside(_task: object, _run: object, state) -> bool:
    """Whether a task failed by what may be well in a minute: network, file system."""
    error = state.result(raise_on_failure=False)
    return isinstance(error, (OSError, ClusterLostError))


# Only what reaches beyond this machine is tried again: a shared file system, a cluster.
# What is in the store is not run twice.
_again = {
    "retries": 2,
    "retry_delay_seconds": [10, 60],
    "retry_condition_fn": outside,
}


@task(name="experiment", task_run_name="experiment {path}", tags=["simulation"])
def experiment(path: str, store: str) -> str:
    """Run one experiment; returns the id of its run."""
    id = experiments.run(load_spec(path), Path(store))
    events.runs_committed([id])
    return id


@task(name="campaign", task_run_name="campaign", tags=["simulation"], **_again)
def campaign(asked: requests.Campaign) -> dict:
    """Run what is not in the store; a failure is told and does not end the night."""
    log = get_run_logger()
    tell = artifacts.progress("campaign-progress", log.info)
    ran = campaigns.run_campaign(asked, tell)
    for why in ran.failed:
        log.warning(why)
    events.runs_committed(ran.new)
    return ran.runs


@task(name="batch", task_run_name="{ids[0]} and after", tags=["simulation"], **_again)
def batch(asked: requests.Campaign, ids: list[str]) -> list[str]:
    """Run a part of a campaign in this process; returns what failed, in words."""
    return campaigns.run_part(asked, ids)


@task(name="identify", task_run_name="identify", tags=["analysis"])
def identify(runs: dict, store: str) -> None:
    """Fit the parameters of the model; the errors are a table among the artifacts."""
    fit, held_out = tuple(runs["fit"]), tuple(runs["held_out"])
    robot = robot_of(fit, Path(store))
    request = requests.Identify(fit, robot, held_out, store=store)
    logs = identification.read_logs(request)
    artifacts.identification(*identification.identify(request, logs))


@task(name="calibrate", task_run_name="calibrate", tags=["analysis"])
def calibrate(runs: dict, store: str) -> list[str]:
    """Fit the look-up tables; returns the ids of model and validation."""
    ids = (*runs["fit"], *runs["held_out"])
    request = requests.Calibrate(ids, robot_of(ids, Path(store)), store=store)
    done = calibration.calibrate(request, *calibration.read_logs(request))
    artifacts.calibration(done)
    return list(done.kept.values())


@task(name="validate", task_run_name="validate", tags=["analysis"])
def validate(ids: list[str], window: float, store: str) -> list[str]:
    """Try the nominal model on runs; returns the ids of the validations."""
    wanted = (requests.Validate(id, window, store) for id in ids)
    made = {request.run: validation.validate(request) for request in wanted}
    artifacts.validations(made)
    return [id for id, _ in made.values()]


@task(name="diagnose", task_run_name="diagnose", tags=["analysis"])
def diagnose(runs: dict, store: str, model: str | None = None) -> list[str]:
    """Identify, diagnose, augment, prove; the verdict goes into the store."""
    request = diagnosis.request_of(runs, Path(store), model)
    return list(diagnosis.diagnose_runs(request, surroundings().progress))


@task(name="watch", task_run_name="watch", tags=["monitoring"])
def watch(ids: list[str], model: str | None, good: list[str], store: str) -> list[str]:
    """Watch the sensors of runs; an alarm is told as an event."""
    place = Path(store)
    # What the robot has, else what was found of it last.
    model = model or in_force(ids, place).diagnosis
    model = model or monitoring.latest_diagnosis(ids, place)
    if model is None:
        return _nothing("No diagnosis of this arm yet: nothing to compare with.")
    healthy = tuple(good) or source_of(model, place).good
    new = tuple(run for run in ids if run not in healthy)
    if not new:
        return _nothing("No run that is not one of the healthy ones.")
    if len(healthy) < LEAST_RUNS:
        return _nothing(f"{len(healthy)} healthy runs, {LEAST_RUNS} are the least.")
    request = requests.Monitor(model, new, healthy, store=store)
    id, found, watched = monitoring.monitor(request)
    artifacts.monitoring(id, found, watched)
    alarmed = [run for run, alarms in found.alarms.items() if alarms]
    many = f"alarms in {len(alarmed)} of" if alarmed else "no alarm in"
    names.rename(f"{found.monitor.model.robot.name}: {many} {len(new)} new runs")
    if alarmed:
        events.alarm_raised(id, alarmed, found.calibration)
    return [id]


def _nothing(why: str) -> list[str]:
    get_run_logger().info(why)
    artifacts.record("monitor", (), f"{why} Nothing was watched.")
    names.rename(f"monitor: nothing watched. {why}")
    return []


@task(name="rerun", task_run_name="rerun {id}", tags=["simulation"])
def rerun(id: str, verify: bool, store: str) -> bool:
    """Make a record again and compare; returns whether all values are the same bits."""
    made = reruns.rerun(id, Path(store), verify)
    rows = [asdict(channel) for channel in made.apart]
    words = str(made.cause or "Bit for bit the same.")
    kept = [id for id in (made.made, made.noted) if id]
    artifacts.record("rerun", kept, words, rows)
    same = not rows and made.cause is None
    names.rename(f"rerun {id}: {'same bits' if same else 'not reproduced'}")
    return same


@task(name="report", task_run_name="report {ids[0]}", tags=["report"])
def report(ids: list[str], store: str) -> str:
    """Write the page; it and the verdict in words appear among the artifacts."""
    page = stored.diagnosis_page(ids, Path(store), "nightly")
    return _told(page, ids, Path(store))


def _told(page: Path, ids: Sequence[str], store: Path) -> str:
    """Show a verdict, and give the flow run its name."""
    name = names.of_diagnosis(ids[0], store)
    artifacts.verdict(name, page, stored.words(ids[1], store))
    names.rename(name)
    return str(page)


@task(name="demo-experiments", task_run_name="experiments", tags=["simulation"])
def demo_experiments(asked: requests.Demo) -> dict:
    """Run what is not in the store, in a pool of processes."""
    return demo.run_experiments(asked, surroundings().progress, surroundings().pool)


@task(name="open-seal", task_run_name="open-seal", tags=["report"])
def open_seal(runs: dict, diagnosis: str, store: str) -> list[dict]:
    """Read what was hidden, after the verdict is stored."""
    return demo.open_seal(runs, diagnosis, Path(store))


@task(name="demo-report", task_run_name="report {ids[0]}", tags=["report"])
def demo_report(ids: list[str], runs: dict, hidden: list[dict], store: str) -> str:
    """Write the page; it appears among the artifacts."""
    page = stored.demo_page(ids, runs["fit"][0], hidden, Path(store))
    return _told(page, ids, Path(store))


@task(name="study", task_run_name="study", tags=["analysis"], timeout_seconds=None)
def study(n: int, seed: int, store: str, background: BackgroundWord = CLEAN) -> str:
    """Run what is not in the store, in a pool of processes; write the page."""
    asked = Asked(n, seed, background=background)
    log, place = get_run_logger(), Path(store)
    made = blind_run.run_study(asked, place, lambda what, _: log.info(what))
    for why in made.failed:
        log.warning(why)
    page = store_page(asked, made, place)
    figures = (f"- {what}: {value}, {n}" for what, value, n in lines(made.summary))
    words = "\n".join([f"{headline(made.summary)}\n", *figures])
    artifacts.study(page, words, made.id)
    names.rename(f"{asked.robot} blind study: {headline(made.summary)}")
    return str(page)


@task(name="verify", task_run_name="verify", tags=["report"])
def verify(store: str) -> list[str]:
    """Hold every byte of a store against its sums."""
    log, out = get_run_logger(), []
    for line in verification.verify(Path(store)):
        log.info(line)
        out.append(line)
    return out
