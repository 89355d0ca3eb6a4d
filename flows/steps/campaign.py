"""Run many experiments over all cores; skip those that are in the store.

A campaign has no journal: the id of a run identifies its spec, and a run is in the
store completely or not at all. So the same command completes an interrupted campaign.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter

from flows.outputs import Progress
from flows.requests import Campaign
from flows.settings import cores, store_folder
from flows.specs import load_campaign
from flows.steps import experiment
from flows.steps.experiment import PlannedExperiment, plan
from flows.workers import Processes, spread
from residual.errors import InputError, RunError
from warehouse.remote import store_name

Runs = dict[str, list[str]]  # ids by role


@dataclass(frozen=True, slots=True)
class Summary:
    """What became of a campaign."""

    planned: tuple[PlannedExperiment, ...]  # all experiments, in order
    # What failed and why, by the id of its run; all others are in the store.
    failed: Mapping[str, str]
    seconds: float = 0.0  # time that it took

    @property
    def stored(self) -> tuple[str, ...]:
        """Ids of all runs that are in the store now."""
        return tuple(p.run_id for p in self.planned if p.run_id not in self.failed)

    @property
    def new(self) -> tuple[str, ...]:
        """Ids of those that were not there before."""
        known = {p.run_id for p in self.planned if p.stored}
        return tuple(id for id in self.stored if id not in known)


def run_all(
    planned: Sequence[PlannedExperiment],
    store: Path,
    tell: Progress | None = None,
    executor: Executor | None = None,
) -> Summary:
    """Run what is not in the store, in as many processes as there are cores.

    Returns:
        What became of them; a failure is in it and raises nothing.
    """
    missing = [p for p in planned if not p.stored]
    begun, failed = perf_counter(), {}
    if missing and executor is None:
        with Processes(min(cores(), len(missing))) as ours:
            return run_all(planned, store, tell, ours)
    # The store's name and not its folder: on another machine that is another one.
    work = partial(run_one, store=store_name(store))
    done = spread(executor, work, missing) if executor else ()
    for count, each in enumerate(done, start=1):
        at = missing[each.index]
        if why := _line(each.error) or misplaced(at, each.value, store):
            failed[at.run_id] = f"{at.label}: {why}"
        if tell:
            word = "failed" if why else "stored"
            tell(f"{word} {count} of {len(missing)}: {at.label}", count / len(missing))
    return Summary(tuple(planned), failed, round(perf_counter() - begun, 2))


def outside(error: BaseException | None) -> bool:
    """Return whether what failed may be well in a minute: a process, disk, network.

    All else fails again, since a spec and its code decide it.
    """
    return isinstance(error, OSError)


def advice(summary: Summary) -> str:
    """Return what to do about the failures of a campaign, in two sentences."""
    return (
        f"{len(summary.failed)} of {len(summary.planned)} experiments failed (see "
        "above). A spec that cannot run fails again: change or remove it. The same "
        "command reruns what a lost process, disk or network stopped."
    )


def document(summary: Summary, done: bool = True) -> dict:
    """Return the JSON of a campaign: every experiment, in its order.

    Args:
        done: Whether it was run; else what is not stored is "to run".
    """
    new = summary.new

    def state(each: PlannedExperiment) -> str:
        if each.run_id in summary.failed:
            return "failed" if done else "will fail"
        if each.run_id in new:
            return "stored" if done else "to run"
        return "was there"

    return {
        "schema": 1,
        "campaign": next((p.campaign for p in summary.planned), None),
        "runs": [
            {
                "run_id": each.run_id,
                "label": each.label,
                "state": state(each),
                "why": summary.failed.get(each.run_id),
            }
            for each in summary.planned
        ],
        "seconds": summary.seconds if done else None,
    }


def planned_of(request: Campaign) -> list[PlannedExperiment]:
    """Return the experiments of a campaign, and which of them are stored.

    Raises:
        InputError: If the campaign is not usable, or of several robots.
    """
    entries = load_campaign(request.path, request.seed)
    robots = {entry.spec.robot for entry in entries}
    if len(robots) > 1:
        raise InputError(f"{request.path} has {len(robots)} robots; expected one.")
    return plan(entries, store_folder(request.store), Path(request.path).stem)


def by_role(request: Campaign, summary: Summary) -> Runs:
    """Return the stored runs of a campaign by role: fit and held_out.

    Raises:
        RunError: If none is left to fit.
    """
    runs: Runs = {"fit": [], "held_out": []}
    for each in summary.planned:
        if each.run_id in summary.stored:
            kind = each.spec.trajectory.kind
            role = "held_out" if kind == request.held_out else "fit"
            runs[role].append(each.run_id)
    if not runs["fit"]:
        all_out = f"all motions are '{request.held_out}', held out"
        why = next(iter(summary.failed.values()), all_out)
        raise RunError(f"{request.path} has no run to fit: {why}.")
    return runs


def failures(
    batch: Sequence[PlannedExperiment], error: BaseException, store: Path
) -> dict[str, str]:
    """Return why experiments of a batch that failed are not in the store, by run."""
    lost = [p for p in batch if not experiment.is_stored(store, p.spec, p.run_id)]
    return {each.run_id: f"{each.label}: {_line(error)}" for each in lost}


def run_one(planned: PlannedExperiment, store: str) -> str:
    """Run one experiment of a campaign; returns the id of its run."""
    return experiment.run(planned.spec, store_folder(store), planned.campaign)


def misplaced(planned: PlannedExperiment, run_id: str, store: Path) -> str:
    """Return why a run that was stored is not where it should be; "" where it is."""
    # A process loads the code anew, and the id of a run is also that of its code.
    if run_id != planned.run_id:
        return f"stored as {run_id}: the code was changed since the start"
    if not experiment.is_stored(store, planned.spec, run_id):
        return (
            f"stored elsewhere than in {store_name(store)}: a cluster needs a store on "
            "object storage (--store s3://BUCKET/PREFIX), or a file system that all "
            "its machines share"
        )
    return ""


def _line(error: BaseException | None) -> str:
    return " ".join(str(error).split()) if error else ""
