"""Many experiments over all cores: what is stored is not run again.

There is no journal to go wrong: the id of a run says what it is, and a run is in the
store whole or not at all. So whatever ends a campaign, the same command completes it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter

from flows.outputs import Progress
from flows.requests import Campaign
from flows.settings import cores, store_folder
from flows.specs.campaign import load_campaign
from flows.specs.experiment import ExperimentSpec
from flows.steps import experiment
from flows.steps.experiment import Planned, plan
from flows.workers.pool import Pool, chosen_runner, outcomes, workers_of
from flows.workers.pool import Runs as Workers
from residual.errors import InputError, RunError
from warehouse.mirror import shown

Runs = dict[str, list[str]]  # ids by role


@dataclass(frozen=True, slots=True)
class Summary:
    """What became of a campaign."""

    planned: tuple[Planned, ...]  # all experiments, in order
    # What failed and why, by the id of its run; all others are in the store.
    failed: Mapping[str, str]
    seconds: float  # time that it took

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
    planned: Sequence[Planned],
    store: Path,
    tell: Progress | None = None,
    pool: Workers | None = None,
) -> Summary:
    """Run what is not in the store, in as many processes as there are cores.

    Returns:
        What became of them; a failure is in it and raises nothing.
    """
    missing = [p for p in planned if not p.stored]
    begun, failed = perf_counter(), {}
    if missing and pool is None:
        with Pool(min(cores(), len(missing))) as own:
            return run_all(planned, store, tell, own)
    # The store's name and not its folder: on another machine that is another one.
    jobs = [partial(_run, p.spec, shown(store), p.campaign) for p in missing]
    done = outcomes(pool, jobs) if pool else ()
    for count, (index, id, why) in enumerate(done, start=1):
        at = missing[index]
        if why := why or _misplaced(at, id, store):
            failed[at.run_id] = f"{at.label}: {why}"
        if tell:
            word = "failed" if why else "stored"
            tell(f"{word} {count} of {len(missing)}: {at.label}", count / len(missing))
    return Summary(tuple(planned), failed, round(perf_counter() - begun, 2))


def _planned(request: Campaign) -> list[Planned]:
    """Return the experiments of a campaign, and which of them are stored.

    Raises:
        InputError: If the campaign is not usable, or of several robots.
    """
    entries = load_campaign(request.path, request.seed)
    robots = {entry.spec.robot for entry in entries}
    if len(robots) > 1:
        raise InputError(f"{request.path} has {len(robots)} robots; expected one.")
    return plan(entries, store_folder(request.store), Path(request.path).stem)


def run_campaign(
    request: Campaign, tell: Progress | None = None
) -> tuple[Runs, Summary]:
    """Run what is not in the store; returns ids by role, and what became of all."""
    experiments = _planned(request)
    runner = chosen_runner(request.runner, request.trust_network)
    with workers_of(runner, sum(not p.stored for p in experiments)) as pool:
        summary = run_all(experiments, store_folder(request.store), tell, pool)
    return _by_role(request, experiments, summary), summary


def _by_role(
    request: Campaign, experiments: Sequence[Planned], summary: Summary
) -> Runs:
    """Return the stored runs by role: fit and held_out."""
    runs: Runs = {"fit": [], "held_out": []}
    for each in experiments:
        if each.run_id in summary.stored:
            kind = each.spec.trajectory.kind
            role = "held_out" if kind == request.held_out else "fit"
            runs[role].append(each.run_id)
    if not runs["fit"]:
        all_out = f"all motions are '{request.held_out}', held out"
        why = next(iter(summary.failed.values()), all_out)
        raise RunError(f"{request.path} has no run to fit: {why}.")
    return runs


def _run(spec: ExperimentSpec, store: str, campaign: str | None) -> str:
    return experiment.run(spec, store_folder(store), campaign)


def _misplaced(planned: Planned, run_id: str, store: Path) -> str:
    # A process loads the code anew, and the id of a run is also that of its code.
    if run_id != planned.run_id:
        return f"stored as {run_id}: the code was changed since the start"
    if not experiment.is_stored(store, planned.spec, run_id):
        return (
            f"stored elsewhere than in {shown(store)}: a cluster needs a store on "
            "object storage (--store s3://BUCKET/PREFIX), or a file system that all "
            "its machines share"
        )
    return ""
