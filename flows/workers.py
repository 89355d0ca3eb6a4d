"""Jobs in processes of this machine, an executor of ``concurrent.futures``; locks of files.

A ProcessPoolExecutor is broken as a whole by a worker that dies (out of memory, a fault
in compiled code). Each thread of `ProcessExecutor` therefore has a pool of one
process, so that only the job of the dead process fails.
"""

import multiprocessing
import multiprocessing.connection
import os
import re
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
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from flows.settings import ONE_THREAD
from residual.errors import InputError, ModelgapError, RunError
from warehouse.bucket import is_loopback_host

RUNNER, TRUST = "MODELGAP_RUNNER", "MODELGAP_TRUST_NETWORK"
DASK = "dask"
_SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True, slots=True)
class JobResult:
    """One finished job."""

    index: int  # its place in the list of jobs
    value: Any = None  # what the work returned, None if it failed
    error: BaseException | None = None  # why it failed, None if it did not


def run_jobs(
    executor: Executor, work: Callable[[Any], Any], jobs: Sequence[Any]
) -> Iterator[JobResult]:
    """Yield the results of jobs in the order in which they finish.

    Args:
        work: A function of a module, of one argument that can be pickled.
    """
    futures = {executor.submit(run_job, work, job): i for i, job in enumerate(jobs)}
    ready = [future for future in futures if future.done()]
    for future in chain(ready, as_completed(futures.keys() - set(ready))):
        error = future.exception()
        yield JobResult(futures[future], None if error else future.result(), error)


def run_job(work: Callable, *arguments: Any) -> Any:
    """Run a job; its errors can be pickled."""
    try:
        return work(*arguments)
    except ModelgapError as error:
        raise InputError(str(error)) from None
    except OSError:
        raise
    except Exception as error:
        raise RunError(f"{type(error).__name__}: {error}") from error


class ProcessExecutor(ThreadPoolExecutor):
    """Threads with a process each; a job whose process dies is a ChildProcessError."""

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self._local = threading.local()
        self._pids: list[int] = []

    def submit(self, work: Callable, /, *arguments: Any) -> Future:
        """Do a job in a process (`Executor.submit`)."""
        return super().submit(self._run, work, *arguments)

    def __exit__(self, *_: object) -> None:
        # A kill is harmless: a job stores its result whole or not at all.
        self.shutdown(wait=False, cancel_futures=True)
        for pid in self._pids:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.shutdown()

    def _run(self, work: Callable, *arguments: Any) -> Any:
        try:
            future = self._local.pool.submit(work, *arguments)
        except (AttributeError, BrokenProcessPool):  # none yet, or it died while idle
            self._local.pool = ProcessPoolExecutor(1, _SPAWN, _begin)
            self._pids.append(self._local.pool.submit(os.getpid).result())
            future = self._local.pool.submit(work, *arguments)
        try:
            return future.result()
        except BrokenProcessPool:
            raise ChildProcessError(
                "the worker process died: out of memory, or killed by another program"
            ) from None


def _begin() -> None:
    """Set up a process: one BLAS thread; it ends with its parent, not by Ctrl-C."""
    os.environ.update(ONE_THREAD)
    threadpool_limits(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def end_with_parent() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


@contextmanager
def lock_file(path: Path, wait: bool = False) -> Iterator[bool]:
    """Lock a file against other processes; yields whether this one has the lock."""
    import fcntl  # which Windows has not

    with path.open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError:
            yield False
        else:
            yield True


class InlineExecutor(Executor):
    """An executor that does each job when it is submitted."""

    def submit(self, work: Callable, /, *arguments: Any) -> Future:
        """Do a job (`Executor.submit`)."""
        future: Future = Future()
        try:
            future.set_result(work(*arguments))
        except Exception as error:
            future.set_exception(error)
        return future


def read_runner_setting() -> str | None:
    """Return where flows run their tasks, by $MODELGAP_RUNNER.

    Returns:
        None for threads of this machine, "dask" for a Dask cluster of this machine,
        else the address of a Dask scheduler.

    Raises:
        InputError: If it is another word, or an address on an untrusted network.
    """
    word = os.environ.get(RUNNER) or "threads"
    if word in ("threads", DASK):
        return None if word == "threads" else DASK
    parts = re.fullmatch(r"dask://(\[[0-9a-fA-F:]+\]|[\w.-]+):[0-9]{1,5}", word)
    if parts is None:
        raise InputError(f"${RUNNER} is '{word}', expected threads, dask or dask://HOST:PORT.")
    if not is_loopback_host(parts[1].strip("[]")) and os.environ.get(TRUST) != "1":
        raise InputError(
            f"${RUNNER} is '{word}', on the network: Dask runs any code that is sent "
            f"to it, without encryption. If you trust that network, set {TRUST}=1."
        )
    return word.replace(DASK, "tcp", 1)
