"""The flows nightly, campaign, monitor and verify.

To be imported under `flows.settings.build_prefect_environment`. prefect.yaml says when
each starts, `$MODELGAP_RUNNER` where their tasks run. `store` is a folder; None is
$MODELGAP_STORE, else ./store.
"""

from contextlib import nullcontext
from functools import partial

from prefect import flow, get_run_logger
from prefect.runtime import flow_run

from flows.pipelines import adoption_flow, tasks
from flows.pipelines import project as projects
from flows.settings import HEALTHY, count_cores, resolve_store_folder
from flows.steps import diff as verification
from flows.steps import experiment as campaigns
from flows.steps import monitor as monitoring
from flows.workers import ProcessExecutor, read_runner_setting
from residual import one_blas_thread
from residual.errors import RunError

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
    ids = tasks.diagnose(runs, place, adoption_flow.find_adopted_model(runs, place))
    page = tasks.report(ids, place)
    adoption_flow.adopt_or_propose(ids[0], place, auto)
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
    tag = projects.find_healthy_tag(project, runs) if project else HEALTHY
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
