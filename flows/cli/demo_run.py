"""The demonstration from end to end: as a Prefect flow, or the same steps bare."""

import os
from dataclasses import dataclass
from pathlib import Path

from flows.progress import Progress
from flows.report.stored import demo_page
from flows.requests import Demo
from flows.scheduled.surroundings import Surroundings, surrounded
from flows.service.key import CLIENT, store_key
from flows.service.server import answers, start_server
from flows.service.state import read_running
from flows.settings import API, cores, prefect_home, prepare_prefect, store_folder
from flows.steps import demo as steps
from flows.steps.diagnose import diagnose_runs, request_of
from flows.steps.experiment import load_engine
from flows.workers.pool import Pool


@dataclass(frozen=True, slots=True)
class Made:
    """What a demonstration left in the store.

    Attributes:
        diagnosis: Id of the diagnosis.
        proof: Id of the validation with its curves.
        hidden: What was under the seal, as JSON can hold it.
        page: The report.
    """

    diagnosis: str
    proof: str
    hidden: list[dict]
    page: Path


def run_plain(asked: Demo, progress: Progress | None = None) -> Made:
    """Do all steps one after the other, without Prefect.

    Args:
        asked: Which demonstration.
        progress: Told the stage and the share done.
    """
    store = store_folder(asked.store)
    runs = steps.run_experiments(asked, progress)
    ids = diagnose_runs(request_of(runs, store), progress)
    hidden = steps.open_seal(runs, ids[0], store)
    return Made(*ids, hidden, demo_page(ids, runs["fit"][0], hidden, store))


def run_flow(asked: Demo, progress: Progress | None = None) -> Made:
    """Do the same steps as a Prefect flow; no server need run.

    A server that PREFECT_API_URL names and that answers is used, else one of our own.

    Args:
        asked: Which demonstration; Prefect's own files go into its store too.
        progress: Told the stage and the share done.
    """
    store = store_folder(asked.store)
    home = prefect_home(store)
    prepare_prefect(home)
    own = None if answers(os.environ.get(API)) else start_server(home)
    running = read_running(home)
    if running and running.url == os.environ.get(API):
        os.environ.setdefault(CLIENT, store_key(home))
    with Pool(cores()) as pool:
        # A server takes as long to start as the processes take to load the engine.
        pool.warm(load_engine)
        if progress:
            progress("starting", 0.0)
        if own:
            own.use()
        # Only now, since Prefect takes its settings when it is loaded.
        from flows.scheduled.flows import demo

        if own:
            own.wait()
        with surrounded(Surroundings(progress, pool)):
            done = demo(asked.seed, asked.effect, str(store), asked.background)
    page = Path(done["page"])
    return Made(done["diagnosis"], done["proof"], done["hidden"], page)
