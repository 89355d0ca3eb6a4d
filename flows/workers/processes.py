"""Where jobs are computed, as executors of ``concurrent.futures``.

Here every thread of ``Processes`` keeps a process of its own: a ProcessPoolExecutor is
broken as a whole by a process that dies (out of memory, a fault in compiled code), and
all that ran beside it would fail with it. A Dask cluster is somebody else's scheduler
and workers; Dask itself gives the job of a lost worker to another one.
"""

import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain
from queue import SimpleQueue
from typing import Any
from urllib.parse import urlsplit

from flows.settings import ONE_THREAD, cores
from residual.errors import InputError, ModelgapError, RunError
from warehouse.bucket import is_loopback

RUNNER, TRUST = "MODELGAP_RUNNER", "MODELGAP_TRUST_NETWORK"
THREADS, DASK = "threads", "dask"
_DIED = "its process ended without a word; out of memory, or killed from outside"
_PATIENCE = 20  # s until a scheduler must have answered
_SPAWN = multiprocessing.get_context("spawn")
_starting = threading.Lock()


@dataclass(frozen=True, slots=True)
class Done:
    """One finished job."""

    index: int  # its place in the list of jobs
    value: Any = None  # what the work returned, None if it failed
    error: BaseException | None = None  # why it failed, None if it did not


def spread(
    executor: Executor, work: Callable[[Any], Any], jobs: Sequence[Any]
) -> Iterator[Done]:
    """Yield jobs as they are done; one failure is one result.

    Args:
        work: A function of a module, of one argument that can be pickled.
    """
    futures = {executor.submit(plainly, work, job): i for i, job in enumerate(jobs)}
    ready = [future for future in futures if future.done()]
    for future in chain(ready, as_completed(futures.keys() - set(ready))):
        error = future.exception()
        yield Done(futures[future], None if error else future.result(), error)


def plainly(work: Callable, *arguments: Any) -> Any:
    """Do a job; whatever it raises can cross to another process."""
    try:
        return work(*arguments)
    except ModelgapError as error:
        raise InputError(str(error)) from None
    except OSError:
        raise
    except Exception as error:
        raise RunError(f"{type(error).__name__}: {error}") from error


class Processes(ThreadPoolExecutor):
    """Threads that have each job done by a process; ChildProcessError where it dies."""

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self._all = [_Process() for _ in range(workers)]
        self._free: SimpleQueue[_Process] = SimpleQueue()
        for process in self._all:
            self._free.put(process)

    def submit(self, work: Callable, /, *arguments: Any) -> Future:
        """Let a process do a job (`Executor.submit`)."""
        return super().submit(self._apart, work, *arguments)

    def __exit__(self, *_: object) -> None:
        # What a job stores is whole or not there at any kill.
        self.shutdown(wait=False, cancel_futures=True)
        for process in self._all:
            process.kill()
        self.shutdown()

    def _apart(self, work: Callable, *arguments: Any) -> Any:
        process = self._free.get()
        try:
            return process.run(work, *arguments)
        finally:
            self._free.put(process)


class _Process:
    """A process that is started by its first job, and again after its death."""

    def __init__(self) -> None:
        self._executor: ProcessPoolExecutor | None = None
        self._id: int | None = None

    def run(self, work: Callable, *arguments: Any) -> Any:
        executor = self._executor or self._started()
        try:
            try:
                future = executor.submit(work, *arguments)
            except BrokenProcessPool:  # killed from outside since its last job
                executor = self._started()
                future = executor.submit(work, *arguments)
            return future.result()
        except BrokenProcessPool:
            self._executor = None
            raise ChildProcessError(_DIED) from None

    def kill(self) -> None:
        if self._executor is not None and self._id is not None:
            with suppress(ProcessLookupError):
                os.kill(self._id, signal.SIGKILL)

    def _started(self) -> ProcessPoolExecutor:
        # One BLAS thread there, by what the environment is when it starts; ours stay.
        with _starting:
            ours = dict(os.environ)
            os.environ.update(ONE_THREAD)
            try:
                executor = ProcessPoolExecutor(1, _SPAWN, _begin)
                self._id = executor.submit(os.getpid).result()
            finally:
                os.environ.clear()
                os.environ.update(ours)
        self._executor = executor
        return executor


def _begin() -> None:
    """Set up a new process: Ctrl-C is its parent's matter, and so is when to end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def end_with_parent() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


class Here(Executor):
    """The same without processes: each job is done as it is submitted."""

    def submit(self, work: Callable, /, *arguments: Any) -> Future:
        """Do a job (`Executor.submit`)."""
        future: Future = Future()
        try:
            future.set_result(work(*arguments))
        except Exception as error:
            future.set_exception(error)
        return future


def chosen_runner(word: str | None = None, trust_network: bool = False) -> str | None:
    """Return the address of a Dask scheduler, "dask" for one of ours; None for threads.

    Args:
        word: What was asked for; without it $MODELGAP_RUNNER, else "threads".
    """
    word = word or os.environ.get(RUNNER) or THREADS
    if word in (THREADS, DASK):
        return None if word == THREADS else DASK
    try:
        parts = urlsplit(word)
        host, port = parts.hostname, parts.port
    except ValueError:
        parts, host, port = None, None, None
    if not parts or parts.scheme != DASK or not host or not port:
        raise InputError(
            f"Runner '{word}': expected threads, dask or dask://HOST:PORT."
        )
    trust_network = trust_network or os.environ.get(TRUST) == "1"
    if not is_loopback(host) and not trust_network:
        raise InputError(
            f"Runner '{word}' is on the network, where Dask runs whatever is sent to "
            "it, unencrypted. If that network is trusted: --trust-network, or "
            f"{TRUST}=1."
        )
    place = f"[{host}]" if ":" in host else host
    return f"tcp://{place}:{port}"


def local_cluster() -> dict[str, Any]:
    """Return what makes a Dask cluster of this machine's cores, of one thread each."""
    workers = {"n_workers": cores(), "threads_per_worker": 1}
    return workers | {"host": "127.0.0.1", "dashboard_address": None}


@contextmanager
def executor_of(address: str | None, jobs: int) -> Iterator[Executor]:
    """Give what does jobs: processes of this machine, or a Dask cluster.

    Raises:
        RunError: If the cluster does not answer or has no workers, or Dask is not
            installed.
    """
    if address is None or jobs == 0:
        with Processes(max(1, min(cores(), jobs))) as made:
            yield made
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise RunError(
            "Dask needs the extra: pip install '.[scale]' in the checkout"
        ) from error
    given = local_cluster() if address == DASK else {"address": address}
    try:
        client = Client(**given, timeout=_PATIENCE, set_as_default=False)
        client.wait_for_workers(1, timeout=_PATIENCE)
    except (OSError, TimeoutError) as error:
        raise RunError(
            f"No Dask cluster with workers answers at {address}. Start it: dask "
            "scheduler, then dask worker with --nthreads 1 on every machine."
        ) from error
    with client:
        yield client.get_executor(pure=False)
