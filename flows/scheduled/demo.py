"""The demonstration as a Prefect flow: decorators and order, the steps are elsewhere.

To be imported after `flows.settings.prepare_prefect`.
"""

from pathlib import Path

from prefect import flow, task
from prefect.artifacts import create_link_artifact, create_markdown_artifact

from flows.scheduled.surroundings import around
from flows.steps import demo as steps


@task(name="experiments")
def experiments(seed: int, effect: str | None, store: str) -> dict:
    """Run what is not in the store, in a pool of processes."""
    asked = steps.Asked(seed, effect)
    return steps.run_experiments(asked, Path(store), around().tell, around().pool)


@task(name="diagnose")
def diagnose(runs: dict, store: str) -> list[str]:
    """Identify, diagnose, augment, validate; the verdict goes into the store."""
    return list(steps.diagnose(runs, Path(store), around().tell))


@task(name="open-seal")
def open_seal(runs: dict, store: str) -> list[dict]:
    """Read what was hidden, after the verdict is stored."""
    return steps.open_seal(runs, Path(store))


@task(name="report")
def report(ids: list[str], runs: dict, hidden: list[dict], store: str) -> str:
    """Write the page; it appears among the artifacts."""
    page = steps.report((ids[0], ids[1]), runs, hidden, Path(store))
    create_link_artifact(page.as_uri(), "report", key="report")
    words = steps.headline(ids[1], Path(store))
    create_markdown_artifact(words, key="verdict", description=f"diagnosis {ids[0]}")
    return str(page)


@flow(name="demo")
def demo(seed: int, effect: str | None, store: str) -> dict:
    """An arm hides an effect; it is found, added, proved, and only then revealed."""
    runs = experiments(seed, effect, store)
    ids = diagnose(runs, store)
    hidden = open_seal(runs, store)
    page = report(ids, runs, hidden, store)
    return {"diagnosis": ids[0], "proof": ids[1], "hidden": hidden, "page": page}
