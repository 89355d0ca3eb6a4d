"""A campaign as a Prefect flow: one task, or a task per batch."""

from pathlib import Path

from prefect import flow, get_run_logger
from prefect.task_runners import ProcessPoolTaskRunner

from flows.scheduled import events, tasks
from flows.scheduled.night import Campaign, by_role, planned
from flows.settings import cores, one_thread_each, store_folder
from flows.workers.runner import PROCESSES, chosen_runner

# Batches per process: some end early, and each costs Prefect a tenth of a second.
_BATCHES = 4


@flow(
    name="campaign",
    flow_run_name="campaign {campaign_file}",
    timeout_seconds=24 * tasks.HOUR,
)
def campaign(
    campaign_file: str,
    seed: int | None = None,
    store: str | None = None,
    runner: str | None = None,
    trust_network: bool = False,
) -> list[str]:
    """Run many experiments on the simulated arm.

    Args:
        campaign_file: The campaign.
        seed: Replaces its seed.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        runner: threads, processes or dask://HOST:PORT; else $MODELGAP_RUNNER.
        trust_network: Whether that host may be another machine.

    Returns:
        The ids of its runs.
    """
    place = str(store_folder(store))
    asked = Campaign(campaign_file, "", seed, runner, trust_network)
    if chosen_runner(runner, trust_network).kind == PROCESSES:
        return in_batches(asked, place)
    where = {"runner": runner, "trust_network": trust_network}
    return tasks.campaign(campaign_file, "", seed, place, where)["fit"]


def in_batches(asked: Campaign, store: str) -> list[str]:
    """Run a campaign as Prefect tasks in processes of Prefect, batch by batch.

    Args:
        asked: The campaign.
        store: The store.

    Returns:
        The ids of its runs.

    Raises:
        RunError: If none of them succeeded.
    """
    wanted = planned(asked, Path(store))
    missing = [p.run_id for p in wanted if not p.stored]
    parts = [missing[i :: _BATCHES * cores()] for i in range(_BATCHES * cores())]
    with one_thread_each(), ProcessPoolTaskRunner(max_workers=cores()) as pool:
        futures = [
            pool.submit(
                tasks.batch,
                {"path": asked.path, "seed": asked.seed, "ids": ids, "store": store},
            )
            for ids in parts
            if ids
        ]
        failed = [why for future in futures for why in future.result()]
    for why in failed:
        get_run_logger().warning(why)
    stored = [p.run_id for p in planned(asked, Path(store)) if p.stored]
    runs = by_role(asked, wanted, stored, failed)["fit"]
    events.runs_committed([id for id in runs if id in missing])
    return runs
