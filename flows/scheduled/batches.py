"""A campaign as tasks of Prefect in processes of Prefect, batch by batch."""

from prefect import get_run_logger
from prefect.task_runners import ProcessPoolTaskRunner

from flows.requests import Campaign
from flows.scheduled import events, tasks
from flows.settings import cores, one_thread_each
from flows.steps.campaign import by_role, planned

# Batches per process: some end early, and each costs Prefect a tenth of a second.
_BATCHES = 4


def in_batches(asked: Campaign) -> list[str]:
    """Run a campaign as Prefect tasks in processes of Prefect, batch by batch.

    Args:
        asked: The campaign.

    Returns:
        The ids of its runs.

    Raises:
        RunError: If none of them succeeded.
    """
    wanted = planned(asked)
    missing = [p.run_id for p in wanted if not p.stored]
    parts = [missing[i :: _BATCHES * cores()] for i in range(_BATCHES * cores())]
    with one_thread_each(), ProcessPoolTaskRunner(max_workers=cores()) as pool:
        futures = [
            pool.submit(tasks.batch, {"asked": asked, "ids": ids})
            for ids in parts
            if ids
        ]
        failed = [why for future in futures for why in future.result()]
    for why in failed:
        get_run_logger().warning(why)
    stored = [p.run_id for p in planned(asked) if p.stored]
    runs = by_role(asked, wanted, stored, failed)["fit"]
    events.runs_committed([id for id in runs if id in missing])
    return runs
