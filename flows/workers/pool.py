"""Work spread over processes: one failure is one result, a dead parent leaves nobody.

loky starts the processes, sees when one dies, and ends those that are still at work.
"""

import os
import signal
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol
from urllib.parse import urlsplit

from loky import ProcessPoolExecutor

from flows.settings import ONE_THREAD, cores, is_loopback
from residual.errors import InputError, ModelgapError, RunError

# A process that has read many logs is larger than at its start, and that is no leak.
_ENVIRONMENT = ONE_THREAD | {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e15"}
_DIED = "its process ended without a word; out of memory, or killed from outside"


class Runs(Protocol):
    """What does jobs: processes, this one, or a cluster."""

    def run(self, work: Callable[[Any], Any], jobs: Sequence[Any]) -> "Iterator[Done]":
        """Yield jobs as they are done."""
        ...


@dataclass(frozen=True, slots=True)
class Done:
    """One finished job."""

    index: int  # its place in the list of jobs
    value: Any = None  # what the work returned, None if it failed
    error: BaseException | None = None  # why it failed, None if it did not


class Pool:
    """Processes that do one kind of work; a context manager."""

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool = _fresh(workers)

    def __enter__(self) -> "Pool":
        return self

    def __exit__(self, *_: object) -> None:
        _stop(self._pool)

    def warm(self, work: Callable[[], object]) -> None:
        """Let every process load what it will need, while the caller does other work.

        Args:
            work: A function of a module, without arguments.
        """
        for _ in range(self._workers):
            self._submit(work)

    def run(self, work: Callable[[Any], Any], jobs: Sequence[Any]) -> Iterator[Done]:
        """Yield jobs as they are done.

        A job that takes its process down with it (out of memory, a fault in compiled
        code) fails alone: those that ran beside it are done again, one at a time.

        Args:
            work: A function of a module, of one argument that can be pickled.
        """
        waiting, suspects = deque(range(len(jobs))), deque[int]()
        running: dict[Future, int] = {}
        while waiting or suspects or running:
            queue, most = (suspects, 1) if suspects else (waiting, self._workers)
            while queue and len(running) < most:
                index = queue.popleft()
                running[self._submit(work, jobs[index])] = index
            first = wait(running, return_when=FIRST_COMPLETED).done
            ended = {running.pop(f): f for f in sorted(first, key=running.get)}
            errors = {i: f.exception() for i, f in ended.items()}
            lost = [i for i, e in errors.items() if isinstance(e, BrokenProcessPool)]
            for i in ended.keys() - set(lost):
                yield Done(i, None if errors[i] else ended[i].result(), errors[i])
            if lost:
                # Nobody knows which of those that ran took the processes down.
                lost = sorted([*lost, *running.values()])
                running.clear()
                self._renew()
                if len(lost) > 1:
                    suspects.extend(lost)
                else:
                    yield Done(lost[0], error=ChildProcessError(_DIED))

    def _submit(self, work: Callable, *arguments: Any) -> Future:
        try:
            return self._pool.submit(work, *arguments)
        except BrokenProcessPool:  # an idle process was killed from outside
            self._renew()
            return self._pool.submit(work, *arguments)

    def _renew(self) -> None:
        _stop(self._pool)
        self._pool = _fresh(self._workers)


class Here:
    """The same without processes, one job after the other."""

    def run(self, work: Callable[[Any], Any], jobs: Sequence[Any]) -> Iterator[Done]:
        """Yield jobs as they are done (`Pool.run`)."""
        for index, job in enumerate(jobs):
            try:
                yield Done(index, work(job))
            except Exception as error:
                yield Done(index, error=error)


def outcomes(
    pool: "Runs", jobs: Sequence[Callable[[], Any]]
) -> Iterator[tuple[int, Any, str]]:
    """Yield of each job its number, its value, and why there is none, in a line."""
    for done in pool.run(plainly, jobs):
        why = " ".join(str(done.error).split()) if done.error else ""
        yield done.index, done.value, why


def plainly(job: Callable[[], Any]) -> Any:
    """Do a job; whatever it raises can cross to the parent process."""
    try:
        return job()
    except ModelgapError as error:
        raise InputError(str(error)) from None
    except Exception as error:
        raise RunError(f"{type(error).__name__}: {error}") from error


def _fresh(workers: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(
        workers, initializer=_begin, initargs=(os.getpid(),), env=_ENVIRONMENT
    )


def _begin(parent: int) -> None:
    """Set up a new process: Ctrl-C is its parent's matter, and so is when to end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_parent() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def _stop(pool: ProcessPoolExecutor) -> None:
    # What a job stores is whole or not there at any kill. Where there is no pgrep, loky
    # warns that it looked for no children of its processes; ours have none.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pool.shutdown(kill_workers=True)


# Where experiments are computed: in processes here, or on a Dask cluster.
#
# Its scheduler and workers are somebody else's. One job is one Dask task, sent by a
# plain client: its workers need no Prefect server, and Dask itself gives the job of a
# lost worker to another one.


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


def chosen_runner(word: str | None = None, trust_network: bool = False) -> str | None:
    """Return the address of the Dask scheduler, tcp://host:port; None for "threads".

    Args:
        word: What was asked for; without it $MODELGAP_RUNNER, else "threads".
    """
    word = word or os.environ.get(RUNNER) or THREADS
    if word == THREADS:
        return None
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
    return f"tcp://{place}:{port}"


@contextmanager
def workers_of(address: str | None, jobs: int) -> Iterator[Runs | None]:
    """Give what runs jobs: processes of ours, or a cluster that somebody else keeps.

    "threads" are processes too: every experiment needs one of its own.
    """
    if jobs == 0:
        yield None
    elif address:
        with Cluster(address) as cluster:
            yield cluster
    else:
        with Pool(min(cores(), jobs)) as pool:
            yield pool
