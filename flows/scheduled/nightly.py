"""Every night a campaign, then what its runs say: the deployment of prefect.yaml."""

from prefect import flow
from prefect.runtime import flow_run

from flows.scheduled import tasks
from flows.settings import store_folder


@flow(
    name="nightly",
    flow_run_name="nightly {campaign_file}",
    timeout_seconds=24 * tasks.HOUR,
)
def nightly(
    campaign_file: str = "examples/nightly.toml",
    held_out: str = "welding",
    store: str | None = None,
    runner: str | None = None,
    trust_network: bool = False,
) -> str:
    """Run new motions of the night; identify, calibrate, validate, diagnose, report.

    Args:
        campaign_file: The campaign; its seed is replaced by the date, so that every
            night has motions of its own and the same night the same.
        held_out: Kind of motion that is not fitted.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        runner: threads, processes or dask://HOST:PORT; else $MODELGAP_RUNNER.
        trust_network: Whether that host may be another machine.

    Returns:
        The page.
    """
    place = str(store_folder(store))
    seed = int(f"{flow_run.scheduled_start_time:%Y%m%d}")
    where = {"runner": runner, "trust_network": trust_network}
    runs = tasks.campaign(campaign_file, held_out, seed, place, where)
    tasks.identify(runs, place)
    tasks.calibrate(runs, place)
    tasks.validate(runs["held_out"] or runs["fit"], 0.25, place)
    return tasks.report(tasks.diagnose(runs, place), place)
