"""A diagnosis by the service of a store, where one is up."""

from pathlib import Path

from flows.requests import Diagnose
from flows.service.api import Api, start_flow, workers_online
from flows.service.key import store_key
from flows.service.server import answers
from flows.service.state import read_running
from flows.settings import PREFECT

_DEPLOYMENT = "diagnose/diagnose"


def start_diagnosis(request: Diagnose, store: Path) -> str | None:
    """Let the service of a store make a diagnosis of runs.

    Returns:
        The name of the flow run; None where nobody would run it, so that it is left to
        the caller.

    Raises:
        RunError: If the server refuses.
    """
    home = store / PREFECT
    running = read_running(home)
    if running is None or running.server is None or not answers(running.url):
        return None
    to = Api(running.url, store_key(home))
    if not workers_online(to):
        return None
    parameters = {
        "runs": list(request.logs),
        "good": list(request.baseline),
        "model": request.model,
        "store": str(store),
    }
    return start_flow(to, _DEPLOYMENT, parameters)
