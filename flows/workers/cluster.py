"""Work spread over a Dask cluster: scheduler and workers are somebody else's.

One job is one Dask task, sent by a plain client: its workers need no Prefect server,
and Dask itself gives the job of a lost worker to another one.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from flows.errors import RunError
from flows.workers.pool import Done

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
