"""The flow of the loop that closes itself: a task a decision, none of them twice.

To be imported after `flows.settings.prepare_prefect`.
"""

from pathlib import Path

from prefect import flow, get_run_logger

from flows.report.closed import ended, headline, keep_page, pairs, render
from flows.scheduled import artifacts, events, tasks
from flows.scheduled.surroundings import surroundings
from flows.settings import store_folder
from flows.steps.closing.arm import Close
from flows.steps.closing.close import adopted_verdict, begun, closed, decided
from flows.steps.closing.known import RUN


@tasks.task(name="decide", task_run_name="decide", tags=["simulation"])
def decide(asked: Close) -> bool:
    """Do what comes next, and write it down; says whether the loop goes on."""
    made = decided(begun(asked), surroundings().progress)
    if made is None:
        return False
    get_run_logger().info(f"{made.number} {made.action}: {made.reason}")
    if made.outcome:
        get_run_logger().info(made.outcome)
    if made.action == RUN:
        events.runs_committed([made.made])
    return True


@tasks.task(name="close-report", task_run_name="close-report", tags=["analysis"])
def report(asked: Close) -> str:
    """Open the seal and write the page; returns its file."""
    store, done = Path(asked.store), closed(asked)
    verdict = adopted_verdict(store, done.known.adopted)
    page = keep_page(done, store, render(done, verdict))
    came = headline(done, pairs(done.hidden, verdict))
    words = f"{came} {ended(done)}"
    get_run_logger().info(words)
    artifacts.verdict(f"{asked.robot}, seed {asked.seed}: {came}", page, words)
    return str(page)


@flow(name="close", flow_run_name="close {seed}", timeout_seconds=24 * tasks.HOUR)
def close(
    robot: str = "irb140",
    budget: int = 8,
    seed: int = 7,
    effects: int | None = None,
    store: str | None = None,
) -> str:
    """Go from a simulated arm with undeclared effects to an adopted model, by itself.

    Every decision is in the store once it is made: a run that was stopped goes on from
    there when it is started again.

    Args:
        robot: Built-in name, URDF file or folder; the arm is simulated.
        budget: How many experiments it may run.
        seed: Seed of the arm, of what it hides, and of the motions.
        effects: How many effects it hides; None to draw one to three.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.

    Returns:
        The page.
    """
    asked = Close(robot, budget, seed, effects, store=str(store_folder(store)))
    while decide(asked):
        pass
    return report(asked)
