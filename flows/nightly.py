"""Every night a campaign, then its diagnosis: the deployment of prefect.yaml."""

from pathlib import Path

from prefect import flow, get_run_logger, task
from prefect.artifacts import create_link_artifact, create_markdown_artifact
from prefect.runtime import flow_run

from flows import watch as steps
from flows.settings import store_folder


@task(name="campaign")
def campaign(path: str, held_out: str, seed: int, store: str) -> dict:
    """Run what is not in the store; a failure is told and does not end the night."""
    log = get_run_logger()
    runs, failed = steps.run_campaign(
        path, held_out, seed, Path(store), lambda stage, _: log.info(stage)
    )
    for why in failed:
        log.warning(why)
    return runs


@task(name="diagnose")
def diagnose(runs: dict, store: str) -> list[str]:
    """Identify, diagnose, augment, validate; the verdict goes into the store."""
    return list(steps.diagnose(runs, Path(store)))


@task(name="report")
def report(ids: list[str], store: str) -> str:
    """Write the page; it and the verdict in words appear among the artifacts."""
    page, words = steps.report((ids[0], ids[1]), Path(store))
    create_link_artifact(page.as_uri(), "report", key="report")
    create_markdown_artifact(words, key="verdict", description=f"diagnosis {ids[0]}")
    return str(page)


@flow(name="nightly")
def nightly(
    campaign_file: str = "examples/nightly.toml",
    held_out: str = "welding",
    store: str | None = None,
) -> str:
    """Run new motions of the night, diagnose them, report.

    Args:
        campaign_file: The campaign; its seed is replaced by the date, so that every
            night has motions of its own and the same night the same.
        held_out: Kind of motion that is not fitted.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    place = str(store_folder(store))
    seed = int(f"{flow_run.scheduled_start_time:%Y%m%d}")
    runs = campaign(campaign_file, held_out, seed, place)
    return report(diagnose(runs, place), place)
