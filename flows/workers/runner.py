"""Where the experiments of a campaign are computed: here, or on a Dask cluster.

Scheduler and workers of the cluster are somebody else's. One job is one Dask task, sent
by a plain client: its workers need no Prefect server, and Dask itself gives the job of
a lost worker to another one.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from flows.settings import cores, is_loopback
from flows.workers.pool import Done, Pool, Runs
from residual.errors import InputError, RunError

RUNNER = "MODELGAP_RUNNER"
THREADS, DASK = "threads", "dask"
_PATIENCE = 20  # s until the scheduler must have answered
# Jobs sent ahead per thread of the cluster: none waits, and 10^6 do not lie there.
_AHEAD = 3


class ClusterLostError(RunError):
    """The cluster does not answer, or has no worker; it may be back in a while."""


class Cluster:
    """A Dask cluster that does one kind of work; a context manager.

    Args:
        address: Of its scheduler, as tcp://host:port.

    Raises:
        ClusterLostError: If it does not answer, or has no workers.
        RunError: If Dask is not installed.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client
        except ImportError as error:
            raise RunError(
                "Dask needs the extra: pip install '.[scale]' in the checkout"
            ) from error
        try:
            self._client = Client(address, timeout=_PATIENCE, set_as_default=False)
            self._client.wait_for_workers(1, timeout=_PATIENCE)
        except (OSError, TimeoutError) as error:
            raise ClusterLostError(
                f"No Dask cluster with workers answers at {address}. Start it: dask "
                "scheduler, then dask worker with --nthreads 1 on every machine."
            ) from error

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close(timeout=5)

    def run(self, work: Callable[[Any], Any], jobs: Sequence[Any]) -> Iterator[Done]:
        """Yield jobs as they are done (`Pool.run`).

        A job whose worker is lost is done again by another one; a job that takes
        several workers with it fails alone.

        Args:
            work: A function of a module that the workers have too.
        """
        from distributed import as_completed

        waiting = iter(range(len(jobs)))
        place: dict[str, int] = {}
        done = as_completed(with_results=False, loop=self._client.loop)

        def send(most: int) -> None:
            for _, index in zip(range(most), waiting, strict=False):
                future = self._client.submit(work, jobs[index], pure=False)
                place[future.key] = index
                done.add(future)

        send(_AHEAD * max(1, sum(self._client.nthreads().values())))
        for future in done:
            index = place.pop(future.key)
            error = future.exception()
            yield Done(index, error=error) if error else Done(index, future.result())
            future.release()
            send(1)


@dataclass(frozen=True, slots=True)
class Runner:
    """Where to compute."""

    kind: str = THREADS  # "threads" or "dask"
    # Of the Dask scheduler, as tcp://host:port; None for the other.
    address: str | None = None


def chosen_runner(word: str | None = None, trust_network: bool = False) -> Runner:
    """Return the runner that a word, else $MODELGAP_RUNNER, else the default names."""
    word = word or os.environ.get(RUNNER) or THREADS
    if word == THREADS:
        return Runner()
    try:
        parts = urlsplit(word)
        host, port = parts.hostname, parts.port
    except ValueError:
        parts, host, port = None, None, None
    if not parts or parts.scheme != DASK or not host or not port:
        raise InputError(f"Runner '{word}': expected threads or dask://HOST:PORT.")
    if not is_loopback(host) and not trust_network:
        raise InputError(
            f"Runner '{word}' is on the network, where Dask runs whatever is sent to "
            "it, unencrypted. If that network is trusted: --trust-network."
        )
    place = f"[{host}]" if ":" in host else host
    return Runner(DASK, f"tcp://{place}:{port}")


@contextmanager
def workers_of(runner: Runner, jobs: int) -> Iterator[Runs | None]:
    """Give what runs jobs: processes of ours, or a cluster that somebody else keeps.

    "threads" are processes too: every experiment needs one of its own.
    """
    if jobs == 0:
        yield None
    elif runner.address:
        with Cluster(runner.address) as cluster:
            yield cluster
    else:
        with Pool(min(cores(), jobs)) as pool:
            yield pool
