"""The flow that settles what a diagnosis left open: motion, run, all logs together.

To be imported after `flows.settings.prepare_prefect`.
"""

from pathlib import Path

from prefect import flow
from threadpoolctl import threadpool_limits

from flows.scheduled import events, tasks
from flows.scheduled.surroundings import surroundings
from flows.settings import store_folder
from flows.steps.planning import ask, execute
from flows.steps.planning.design import design
from flows.steps.planning.motions import Search, with_twins
from flows.steps.planning.request import Next
from residual.errors import InputError
from residual.planning.outlook import HOPELESS


@tasks.task(name="settle", task_run_name="settle {id}", tags=["simulation"])
def settle(id: str, seconds: float, seed: int, store: str) -> list[str]:
    """Design the motion, run it, diagnose all logs; returns diagnosis and proof."""
    tell = surroundings().progress
    request = Next(id, seconds=seconds, seed=seed, store=Path(store))
    asked = ask.ask(request, tell)
    if not asked.question.contests:
        raise InputError(f"Diagnosis {id} leaves nothing open.")
    with threadpool_limits(1, user_api="blas"):
        wanted = Search(asked.question, asked.robot, seconds, seed)
        made = design(with_twins(wanted), tell)
    if made.best.seen.worth < HOPELESS:
        raise InputError(f"No motion tells apart what diagnosis {id} leaves open.")
    run = execute.execute(asked.request, made.best.spec)
    events.runs_committed([run])
    return list(execute.settle(asked.request, run, tell))


@flow(name="next", flow_run_name="next {diagnosis}", timeout_seconds=6 * tasks.HOUR)
def next_experiment(
    diagnosis: str, seconds: float = 20.0, seed: int = 0, store: str | None = None
) -> str:
    """Run the motion that settles a diagnosis of simulated runs, and diagnose again.

    Args:
        diagnosis: Its id.
        seconds: Length of the motion [s].
        seed: Seed of the search.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.

    Returns:
        The page of the new diagnosis.
    """
    place = str(store_folder(store))
    return tasks.report(settle(diagnosis, seconds, seed, place), place)
