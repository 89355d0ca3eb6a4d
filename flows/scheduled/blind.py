"""The blind study as a Prefect flow: decorators and order, the steps are elsewhere.

To be imported after `flows.settings.prepare_prefect`.
"""

from pathlib import Path

from prefect import flow, get_run_logger, task
from prefect.artifacts import create_link_artifact, create_markdown_artifact
from prefect.runtime import flow_run

from flows.blind import run as blind_run
from flows.blind.draw import Asked
from flows.report.study import store_page
from flows.settings import store_folder


@task(name="study")
def study(n: int, seed: int, store: str) -> blind_run.Study:
    """Run what is not in the store, in a pool of processes, and conclude."""
    log = get_run_logger()
    asked = Asked(n, seed)
    made = blind_run.run_study(asked, Path(store), lambda what, _: log.info(what))
    for why in made.failed:
        log.warning(why)
    return made


@task(name="report")
def report(n: int, seed: int, made: blind_run.Study, store: str) -> str:
    """Write the page; it and the figures appear among the artifacts."""
    from flows.report.page.study import headline, lines

    page = store_page(Asked(n, seed), made, Path(store))
    create_link_artifact(page.as_uri(), "blind study", key="blind")
    told = "\n".join(
        f"- {what}: {value}, {n}" for what, value, n in lines(made.summary)
    )
    words = f"{headline(made.summary)}\n\n{told}"
    create_markdown_artifact(words, key="blind-figures", description=f"study {made.id}")
    return str(page)


@flow(name="blind")
def blind(n: int = 40, seed: int | None = None, store: str | None = None) -> str:
    """Hide effects from the diagnosis and count how often it is right.

    Args:
        n: Number of cases.
        seed: Seed of the study; without it the date of the schedule, so that every
            week has cases of its own and the same week the same.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    place = str(store_folder(store))
    if seed is None:
        seed = int(f"{flow_run.scheduled_start_time:%Y%m%d}")
    return report(n, seed, study(n, seed, place), place)
