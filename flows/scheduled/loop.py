"""Flows that wait for an answer of people, while everything else goes on.

To be imported after `flows.settings.prepare_prefect`.
"""

from prefect import flow, get_run_logger
from prefect.flow_runs import suspend_flow_run
from prefect.input import RunInput

from flows.scheduled import loop_tasks
from flows.settings import store_folder


class Answer(RunInput):
    """Whether a model that was proposed shall be that of its robot, and why."""

    adopt: bool = False
    note: str = ""


@flow(name="propose", flow_run_name="propose {diagnosis}")
def propose(diagnosis: str, store: str | None = None) -> str | None:
    """Ask whether the model of a diagnosis shall be that of its robot.

    The run is suspended, without a process, until it is resumed with an answer; then
    it begins again and finds the answer there.

    Args:
        diagnosis: Its id.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.

    Returns:
        The number of the adoption, None where the answer was no.
    """
    place = str(store_folder(store))
    asked = Answer.with_initial_data(
        description=loop_tasks.question(diagnosis, place), adopt=False, note=""
    )
    answer = suspend_flow_run(wait_for_input=asked, timeout=None, key="adopt")
    if not answer.adopt:
        get_run_logger().info("not adopted: that was the answer")
        return None
    return loop_tasks.adopt(diagnosis, place, answer.note)
