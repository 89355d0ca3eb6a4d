"""All Prefect tasks: plain steps with a name, a time limit, and retries where due.

To be imported under `flows.settings.quiet_prefect`. Ids and paths go in and out; what
people want to see becomes an artifact. Prefect caches nothing: the ids of the store are
the cache.
"""

from dataclasses import asdict
from functools import partial
from pathlib import Path

from prefect import get_run_logger
from prefect import task as prefect_task
from prefect.cache_policies import NO_CACHE

from flows import requests
from flows.inputs.given import robot_of
from flows.project.deployments import ALARM
from flows.report import stored
from flows.scheduled import artifacts
from flows.settings import HEALTHY, store_folder
from flows.specs.experiment import load_spec
from flows.steps import calibrate as calibration
from flows.steps import campaign as campaigns
from flows.steps import diagnose as diagnosis
from flows.steps import diff as verification
from flows.steps import experiment as experiments
from flows.steps import identify as identification
from flows.steps import monitor as monitoring
from flows.steps import rerun as reruns
from flows.steps import validate as validation
from flows.workers.pool import ClusterLostError

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


def experiment(spec: str, store: str | None = None) -> str:
    """Run one experiment on the simulated arm and store it; returns the id of its run.

    Args:
        spec: SPEC.toml.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    id = experiments.run(load_spec(spec), store_folder(store))
    artifacts.runs_committed([id])
    return id


@task(name="campaign", task_run_name="campaign", tags=["simulation"], **_again)
def campaign(request: requests.Campaign) -> dict:
    """Run what is not in the store; a failure is told and does not end the night."""
    log = get_run_logger()
    tell = artifacts.progress("campaign-progress", log.info)
    runs, summary = campaigns.run_campaign(request, tell)
    for why in summary.failed.values():
        log.warning(why)
    artifacts.runs_committed(summary.new)
    return runs


def identify(
    fit: list[str], held_out: list[str] | None = None, store: str | None = None
) -> None:
    """Identify the parameters of an arm; the errors are a table among the artifacts.

    Args:
        fit: Ids of the runs to fit.
        held_out: Ids of the runs for the proof.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    place = store_folder(store)
    request = requests.Identify(
        tuple(fit),
        robot=robot_of(fit, place),
        held_out=tuple(held_out or ()),
        store=place,
    )
    logs = identification.read_logs(request)
    artifacts.identification(*identification.identify(request, logs))


def calibrate(runs: list[str], store: str | None = None) -> list[str]:
    """Fit look-up tables to what the model of an arm leaves; returns their ids.

    Args:
        runs: Ids of the runs.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    place = store_folder(store)
    robot = robot_of(runs, place)
    request = requests.Calibrate(tuple(runs), robot=robot, store=place)
    done = calibration.calibrate(request, *calibration.read_logs(request))
    artifacts.calibration(done)
    return list(done.kept.values())


def validate(
    runs: list[str], window: float = 0.25, store: str | None = None
) -> list[str]:
    """Try the nominal model on runs; returns the ids of the validations.

    Args:
        runs: Ids of the runs.
        window: Length of the windows of the open loop [s].
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    place = store_folder(store)
    wanted = (requests.Validate(id, window, place) for id in runs)
    made = {request.run: validation.validate(request) for request in wanted}
    artifacts.validations(made)
    return [id for id, _ in made.values()]


@task(name="diagnose", task_run_name="diagnose", tags=["analysis"])
def diagnose(runs: dict, store: str, model: str | None = None) -> list[str]:
    """Identify, diagnose, augment, prove; the verdict goes into the store."""
    request = diagnosis.request_of(runs, Path(store), model)
    return list(diagnosis.diagnose_runs(request))


def diagnosed_already(runs: list[str], store: str) -> str | None:
    """Return the diagnosis that speaks of runs, and say so; None where none does."""
    found = monitoring.diagnosis_of(runs, Path(store))
    if found:
        name = artifacts.name_of(found, Path(store))
        artifacts.rename(f"explained already: {name}")
        get_run_logger().info(f"diagnosis {found} speaks of these runs")
    return found


def healthy(runs: list[str], good: list[str], store: str) -> list[str]:
    """Return the healthy runs of the arm of some runs; where it has none, those given.

    A run is of no use against itself.
    """
    tagged = monitoring.healthy_runs(runs, Path(store))
    return list(tagged) or [run for run in good if run not in runs]


@task(name="watch", task_run_name="watch", tags=["monitoring"])
def watch(
    ids: list[str], model: str | None, good: list[str], store: str, tag: str = HEALTHY
) -> list[str]:
    """Watch the sensors of runs; an alarm is told as an event."""
    new = monitoring.watch_new(ids, Path(store), model, good, tag)
    if new.record is None or new.found is None:
        get_run_logger().info(new.why)
        artifacts.record("monitor", (), f"{new.why} Nothing was watched.")
        artifacts.rename(f"monitor: nothing watched. {new.why}")
        return []
    artifacts.monitoring(new.record, new.found, new.watched)
    alarmed, count = new.alarmed, len(new.watched)
    many = f"alarms in {len(alarmed)} of" if alarmed else "no alarm in"
    robot = new.found.monitor.model.robot.name
    artifacts.rename(f"{robot}: {many} {count} new runs")
    if alarmed:
        # With the runs that they were judged by.
        good = {"good_ids": list(new.found.calibration)}
        artifacts.tell(ALARM, {"record": new.record, "run_ids": list(alarmed)} | good)
    return [new.record]


def rerun(id: str, verify: bool = True, store: str | None = None) -> bool:
    """Make a record again, and compare; returns whether all values are the same bits.

    Args:
        id: Its id.
        verify: Whether to compare only.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    made = reruns.rerun(id, store_folder(store), verify)
    rows = [asdict(channel) for channel in made.apart]
    words = str(made.cause or "Bit for bit the same.")
    kept = [id for id in (made.made, made.noted) if id]
    artifacts.record("rerun", kept, words, rows)
    same = not rows and made.cause is None
    artifacts.rename(f"rerun {id}: {'same bits' if same else 'not reproduced'}")
    return same


@task(name="report", task_run_name="report {ids[0]}", tags=["report"])
def report(ids: list[str], store: str) -> str:
    """Write the page; it and the verdict in words appear among the artifacts."""
    page = stored.diagnosis_page(ids, Path(store), "nightly")
    name = artifacts.name_of(ids[0], Path(store))
    artifacts.verdict(name, page, stored.words(ids[1], Path(store)))
    artifacts.rename(name)
    return str(page)


def verify(store: str | None = None) -> list[str]:
    """Read the whole store and return what is in it; fail where a byte is another."""
    log, out = get_run_logger(), []
    for line in verification.verify(store_folder(store)):
        log.info(line)
        out.append(line)
    return out
