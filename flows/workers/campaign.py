"""Many experiments over all cores: what is stored is not run again.

There is no journal to go wrong: the id of a run says what it is, and a run is in the
store whole or not at all. So whatever ends a campaign, the same command completes it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from flows.errors import RunError
from flows.settings import cores
from flows.specs.experiment import ExperimentSpec
from flows.steps import experiment
from flows.steps.experiment import Planned
from flows.workers.cluster import Cluster
from flows.workers.pool import Here, Pool
from residual.errors import InputError, ModelgapError

Tell = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Failure:
    """An experiment that did not come to its end.

    Attributes:
        planned: The experiment.
        why: The reason, in one or two lines.
    """

    planned: Planned
    why: str


@dataclass(frozen=True, slots=True)
class Summary:
    """What became of a campaign.

    Attributes:
        planned: All experiments, in order.
        known: How many were in the store already.
        failures: Those that failed; all others are in the store now.
        seconds: Time that it took.
    """

    planned: tuple[Planned, ...]
    known: int
    failures: tuple[Failure, ...]
    seconds: float

    @property
    def stored(self) -> tuple[str, ...]:
        """Ids of all runs that are in the store now."""
        failed = {failure.planned.run_id for failure in self.failures}
        return tuple(p.run_id for p in self.planned if p.run_id not in failed)


def run_all(
    planned: Sequence[Planned],
    store: Path,
    tell: Tell | None = None,
    pool: Pool | Here | Cluster | None = None,
) -> Summary:
    """Run what is not in the store, in as many processes as there are cores.

    Args:
        planned: The experiments (`experiment.plan`).
        store: The store.
        tell: Told what is done and the share of it.
        pool: Processes or a cluster to use; without it, own processes.

    Returns:
        What became of them; a failure is in it and raises nothing.
    """
    missing = [p for p in planned if not p.stored]
    begun, failures = perf_counter(), []
    if missing and pool is None:
        with Pool(min(cores(), len(missing))) as own:
            return run_all(planned, store, tell, own)
    jobs = [(p.spec, store) for p in missing]
    for count, done in enumerate(pool.run(_run, jobs) if pool else (), start=1):
        at = missing[done.index]
        error = done.error or _checked(at, done.value, store)
        if error:
            failures.append(_failure(at, error))
        if tell:
            word = "failed" if error else "stored"
            tell(f"{word} {count} of {len(missing)}: {at.label}", count / len(missing))
    return Summary(
        tuple(planned),
        len(planned) - len(missing),
        tuple(failures),
        round(perf_counter() - begun, 2),
    )


def _run(job: tuple[ExperimentSpec, Path]) -> str:
    """Run one experiment; whatever it raises can cross to the parent process."""
    try:
        return experiment.run(*job)
    except ModelgapError as error:
        raise InputError(str(error)) from None
    except Exception as error:
        raise RunError(f"{type(error).__name__}: {error}") from error


def _checked(planned: Planned, run_id: str, store: Path) -> Exception | None:
    # A process loads the code anew, and the id of a run is also that of its code.
    if run_id != planned.run_id:
        return RunError(f"stored as {run_id}: the code was changed since the start")
    if not experiment.is_stored(store, planned.spec, run_id):
        return RunError(
            f"stored elsewhere than in {store}: a cluster needs a file system that all "
            "its machines share"
        )
    return None


def _failure(planned: Planned, error: BaseException) -> Failure:
    return Failure(planned, " ".join(str(error).split()))
