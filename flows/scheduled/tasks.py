"""All Prefect tasks: plain steps with a name, a time limit, and retries where due.

To be imported after `flows.settings.prepare_prefect`. Ids and paths go in and out; what
people want to see becomes an artifact. Prefect caches nothing: the ids of the store are
the cache.
"""

from dataclasses import asdict
from functools import partial
from pathlib import Path

from prefect import get_run_logger
from prefect import task as prefect_task
from prefect.cache_policies import NO_CACHE

from flows.scheduled import artifacts, events, night, stages
from flows.workers.cluster import ClusterLostError

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
    id = night.run_experiment(path, Path(store))
    events.runs_committed([id])
    return id


@task(name="campaign", task_run_name="campaign {path}", tags=["simulation"], **_again)
def campaign(path: str, held_out: str, seed: int | None, store: str, runner: dict):
    """Run what is not in the store; a failure is told and does not end the night."""
    log = get_run_logger()
    tell = artifacts.progress("campaign-progress", log.info)
    asked = night.Campaign(path, held_out, seed, **runner)
    ran = night.run_campaign(asked, Path(store), tell)
    for why in ran.failed:
        log.warning(why)
    events.runs_committed(ran.new)
    rows = [{"role": role, "run": id} for role, ids in ran.runs.items() for id in ids]
    artifacts.table("runs", rows)
    return ran.runs


@task(name="batch", task_run_name="{ids[0]} and after", tags=["simulation"], **_again)
def batch(path: str, seed: int | None, ids: list[str], store: str) -> list[str]:
    """Run a part of a campaign in this process; returns what failed, in words."""
    return night.run_part(path, seed, ids, Path(store))


@task(name="identify", task_run_name="identify", tags=["analysis"])
def identify(runs: dict, store: str) -> None:
    """Fit the parameters of the model; the errors are a table among the artifacts."""
    done = stages.identify(runs["fit"], runs["held_out"], Path(store))
    artifacts.stage("identify", done)


@task(name="calibrate", task_run_name="calibrate", tags=["analysis"])
def calibrate(runs: dict, store: str) -> list[str]:
    """Fit the look-up tables; returns the ids of model and validation."""
    done = stages.calibrate([*runs["fit"], *runs["held_out"]], Path(store))
    artifacts.stage("calibrate", done)
    return list(done.ids)


@task(name="validate", task_run_name="validate", tags=["analysis"])
def validate(ids: list[str], window: float, store: str) -> list[str]:
    """Try the nominal model on runs; returns the ids of the validations."""
    done = stages.validate(ids, window, Path(store))
    artifacts.stage("validate", done)
    return list(done.ids)


@task(name="diagnose", task_run_name="diagnose", tags=["analysis"])
def diagnose(runs: dict, store: str) -> list[str]:
    """Identify, diagnose, augment, prove; the verdict goes into the store."""
    return list(night.diagnose(runs, Path(store)))


@task(name="watch", task_run_name="watch", tags=["monitoring"])
def watch(ids: list[str], model: str | None, good: list[str], store: str) -> list[str]:
    """Watch the sensors of runs; an alarm is told as an event."""
    done, alarm, picture = stages.watch(ids, model, good, Path(store))
    get_run_logger().info(done.words)
    artifacts.stage("monitor", done)
    if picture is not None:
        artifacts.plot("monitor-scores", picture, done.words)
    if alarm is not None:
        events.alarm_raised(alarm)
    return list(done.ids)


@task(name="rerun", task_run_name="rerun {id}", tags=["simulation"])
def rerun(id: str, verify: bool, store: str) -> bool:
    """Make a record again and compare; returns whether all values are the same bits."""
    # Late: what it loads, no other task needs.
    from flows.steps.rerun.rerun import rerun as again

    made = again(id, Path(store), verify)
    rows = [asdict(channel) for channel in made.apart]
    told = made.cause or "Bit for bit the same."
    kept = tuple(id for id in (made.made, made.noted) if id)
    artifacts.stage("rerun", stages.Stage(kept, str(told), tuple(rows)))
    return not rows and made.cause is None


@task(name="report", task_run_name="report {ids[0]}", tags=["report"])
def report(ids: list[str], store: str) -> str:
    """Write the page; it and the verdict in words appear among the artifacts."""
    page, words = night.report((ids[0], ids[1]), Path(store))
    artifacts.report(page, words, ids[0])
    return str(page)
