"""Many experiments over all cores: what is stored is not run again.

There is no journal to go wrong: the id of a run says what it is, and a run is in the
store whole or not at all. So whatever ends a campaign, the same command completes it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter

from flows.inputs.given import instead, robot_of
from flows.outputs import Progress
from flows.requests import Campaign
from flows.settings import cores, store_folder
from flows.specs.campaign import load_campaign
from flows.specs.experiment import ExperimentSpec
from flows.steps import experiment
from flows.steps.diagnose import diagnose_runs, request_of
from flows.steps.experiment import Planned, plan
from flows.steps.models import in_force
from flows.workers.pool import Pool, chosen_runner, outcomes, workers_of
from flows.workers.pool import Runs as Workers
from residual.errors import InputError, RunError
from warehouse.layout import find_run
from warehouse.mirror import shown
from warehouse.runs import read_manifest, robot_word

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


def planned(request: Campaign) -> list[Planned]:
    """Return the experiments of a campaign, and which of them are stored.

    Raises:
        InputError: If the campaign is not usable, or of several robots.
    """
    entries = load_campaign(request.path, request.seed)
    robots = {entry.spec.robot for entry in entries}
    if len(robots) > 1:
        raise InputError(f"{request.path} has {len(robots)} robots; expected one.")
    known = plan(entries, store_folder(request.store))
    return [replace(each, campaign=Path(request.path).stem) for each in known]


def run_campaign(
    request: Campaign, tell: Progress | None = None
) -> tuple[Runs, Summary]:
    """Run what is not in the store; returns ids by role, and what became of all."""
    experiments = planned(request)
    runner = chosen_runner(request.runner, request.trust_network)
    with workers_of(runner, sum(not p.stored for p in experiments)) as pool:
        summary = run_all(experiments, store_folder(request.store), tell, pool)
    return by_role(request, experiments, summary), summary


def by_role(
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


# Many arms: their campaigns and their diagnoses over processes or a cluster.
#
# What goes to a worker is the name of the store and ids, and ids come back: with a
# store on object storage the machines share no disk.


def arms_of(
    words: Iterable[str],
    held_out: str,
    store: Path,
    pool: Workers,
    tell: Progress | None = None,
) -> tuple[dict[str, Runs], tuple[str, ...]]:
    """Run the campaigns of a fleet, all at once.

    Args:
        words: A campaign file, or ids of runs with commas between them, for each arm.
        held_out: Kind of motion of a campaign that is held out, "" for none.
    """
    requests = {
        w: Campaign(w, held_out, store=store) for w in words if Path(w).is_file()
    }
    planned_of = {word: planned(campaign) for word, campaign in requests.items()}
    every = {each.run_id: each for found in planned_of.values() for each in found}
    summary = run_all(list(every.values()), store, tell, pool)
    arms = {
        word: by_role(requests[word], planned_of[word], summary)
        if word in requests
        else _named(word, store)
        for word in words
    }
    return arms, tuple(summary.failed.values())


def diagnose_arms(
    arms: Mapping[str, Runs], store: Path, pool: Workers, tell: Progress | None = None
) -> dict[str, tuple[str | None, str]]:
    """Diagnose every arm, each against the model that it has.

    Returns:
        The id of each diagnosis, None if it failed, and why.
    """
    jobs = [partial(_diagnose, dict(runs), shown(store)) for runs in arms.values()]
    labels, found = list(arms), {}
    for count, (index, id, why) in enumerate(outcomes(pool, jobs), start=1):
        found[labels[index]] = id, why
        if tell:
            stage = f"diagnosed {count} of {len(arms)}: {labels[index]}"
            tell(stage, count / len(arms))
    return {label: found[label] for label in labels}


def _named(word: str, store: Path) -> Runs:
    if set(word) - set("0123456789abcdef,"):
        raise InputError(
            f"'{word}' is no campaign file that is there, and no ids of runs. Expected "
            "CAMPAIGN.toml, or ids with commas between them."
        )
    return {"fit": [find_run(store, id).id for id in word.split(",") if id]}


def _diagnose(runs: Runs, word: str) -> str:
    store = store_folder(word)
    with instead(_robots(runs, store)):
        model = in_force(runs["fit"], store).diagnosis
        return diagnose_runs(request_of(runs, store, model))[0]


def _robots(runs: Runs, store: Path) -> dict[str, str]:
    """Return where to load the robot from: its file may be on another machine."""
    word = robot_of(runs["fit"], store)
    hash = read_manifest(store, runs["fit"][0]).get("robot_hash")
    return {word: robot_word(store, word, hash)}
