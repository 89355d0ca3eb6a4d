"""Where the experiments of a campaign are computed: a setting."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from urllib.parse import urlsplit

from flows.settings import cores, is_loopback
from flows.workers.cluster import Cluster
from flows.workers.pool import Pool
from residual.errors import InputError

RUNNER = "MODELGAP_RUNNER"
THREADS, PROCESSES, DASK = "threads", "processes", "dask"


@dataclass(frozen=True, slots=True)
class Runner:
    """Where to compute.

    Attributes:
        kind: "threads", "processes" or "dask".
        address: Of the Dask scheduler, as tcp://host:port; None for the others.
    """

    kind: str = THREADS
    address: str | None = None


def chosen_runner(word: str | None = None, trust_network: bool = False) -> Runner:
    """Return the runner that a word, else $MODELGAP_RUNNER, else the default names.

    Args:
        trust_network: Whether the scheduler may be on another machine.

    Raises:
        InputError: If it is none of these, or on another machine without that leave.
    """
    word = word or os.environ.get(RUNNER) or THREADS
    if word in (THREADS, PROCESSES):
        return Runner(word)
    try:
        parts = urlsplit(word)
        host, port = parts.hostname, parts.port
    except ValueError:
        parts, host, port = None, None, None
    if not parts or parts.scheme != DASK or not host or not port:
        raise InputError(
            f"Runner '{word}': expected threads, processes or dask://HOST:PORT."
        )
    if not is_loopback(host) and not trust_network:
        raise InputError(
            f"Runner '{word}' is on the network, where Dask runs whatever is sent to "
            "it, unencrypted. If that network is trusted: --trust-network."
        )
    place = f"[{host}]" if ":" in host else host
    return Runner(DASK, f"tcp://{place}:{port}")


@contextmanager
def workers_of(runner: Runner, jobs: int) -> Iterator[Pool | Cluster | None]:
    """Give what runs jobs: processes of ours, or a cluster that somebody else keeps.

    Threads and processes are the same here: experiments need a process each, and the
    difference is in what Prefect sees (`flows.scheduled.flows`).
    """
    if jobs == 0:
        yield None
    elif runner.address:
        with Cluster(runner.address) as cluster:
            yield cluster
    else:
        with Pool(min(cores(), jobs)) as pool:
            yield pool
