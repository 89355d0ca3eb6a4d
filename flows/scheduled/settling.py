"""The flow that settles what a diagnosis left open: motion, run, all logs together.

To be imported after `flows.settings.prepare_prefect`.
"""

from prefect import flow

from flows.scheduled import events, tasks
from flows.scheduled.surroundings import surroundings
from flows.settings import store_folder
from flows.steps.planning import ask, execute
from flows.steps.planning.design import design
from flows.steps.planning.motions import Search, with_twins
from flows.steps.planning.request import Next
from residual.errors import InputError
from residual.planning.outlook import HOPELESS
from residual.threads import one_blas_thread


@tasks.task(name="settle", task_run_name="settle {id}", tags=["simulation"])
@one_blas_thread
def settle(id: str, request: Next) -> list[str]:
    """Design the motion, run it, diagnose all logs; returns diagnosis and proof."""
    tell = surroundings().progress
    asked = ask.ask(request, tell)
    if not asked.question.contests:
        raise InputError(f"Diagnosis {id} leaves nothing open.")
    wanted = Search(asked.question, asked.robot, request.seconds, request.seed)
    made = design(with_twins(wanted), tell)
    if made.best.seen.worth < HOPELESS:
        raise InputError(f"No motion tells apart what diagnosis {id} leaves open.")
    run = execute.execute(asked.request, made.best.spec)
    events.runs_committed([run])
    return list(execute.settle(asked.request, run, tell))


@flow(name="next", flow_run_name="next {diagnosis}", timeout_seconds=6 * tasks.HOUR)
def next_experiment(
    diagnosis: str,
    want: str | None = None,
    seconds: float = 20.0,
    seed: int = 0,
    store: str | None = None,
) -> str:
    """Run the motion that settles a diagnosis of simulated runs, and diagnose again.

    Args:
        diagnosis: Its id.
        want: An effect that is to be seen, as "payload>=0.5"; None for what is open.
        seconds: Length of the motion [s].
        seed: Seed of the search.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.

    Returns:
        The page of the new diagnosis.
    """
    place = store_folder(store)
    request = Next(diagnosis, want=want, seconds=seconds, seed=seed, store=place)
    return tasks.report(settle(diagnosis, request), str(place))
