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
from flows.workers.pool import Here, Pool, plainly
from flows.workers.runner import Cluster, chosen_runner, workers_of
from residual.errors import InputError, RunError
from warehouse.layout import find_run
from warehouse.mirror import shown
from warehouse.runs import read_manifest, robot_word

Runs = dict[str, list[str]]


@dataclass(frozen=True, slots=True)
class Failure:
    """An experiment that did not come to its end."""

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
    tell: Progress | None = None,
    pool: Pool | Here | Cluster | None = None,
) -> Summary:
    """Run what is not in the store, in as many processes as there are cores.

    Returns:
        What became of them; a failure is in it and raises nothing.
    """
    missing = [p for p in planned if not p.stored]
    begun, failures = perf_counter(), []
    if missing and pool is None:
        with Pool(min(cores(), len(missing))) as own:
            return run_all(planned, store, tell, own)
    # The store's name and not its folder: on another machine that is another one.
    jobs = [partial(_run, p.spec, shown(store), p.campaign) for p in missing]
    for count, done in enumerate(pool.run(plainly, jobs) if pool else (), start=1):
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


def planned(asked: Campaign) -> list[Planned]:
    """Return the experiments of a campaign, and which of them are stored.

    Raises:
        InputError: If the campaign is not usable, or of several robots.
    """
    entries = load_campaign(asked.path, asked.seed)
    robots = {entry.spec.robot for entry in entries}
    if len(robots) > 1:
        raise InputError(f"{asked.path} has {len(robots)} robots; expected one.")
    labelled = ((e.label, e.spec) for e in entries)
    name = Path(asked.path).stem
    known = plan(labelled, store_folder(asked.store))
    return [replace(each, campaign=name) for each in known]


@dataclass(frozen=True, slots=True)
class Ran:
    """What became of a campaign.

    Attributes:
        runs: Ids of the runs that are in the store, by role: fit and held_out.
        new: Ids of those that were not there before.
        failed: What failed, in words.
    """

    runs: Runs
    new: tuple[str, ...]
    failed: tuple[str, ...]


def run_campaign(asked: Campaign, tell: Progress | None = None) -> Ran:
    """Run what is not in the store."""
    wanted = planned(asked)
    runner = chosen_runner(asked.runner, asked.trust_network)
    with workers_of(runner, sum(not p.stored for p in wanted)) as pool:
        summary = run_all(wanted, store_folder(asked.store), tell, pool)
    failed = tuple(f"{f.planned.label}: {f.why}" for f in summary.failures)
    known = {p.run_id for p in wanted if p.stored}
    new = tuple(id for id in summary.stored if id not in known)
    return Ran(by_role(asked, wanted, summary.stored, failed), new, failed)


def by_role(
    asked: Campaign,
    wanted: Sequence[Planned],
    stored: Sequence[str],
    failed: Sequence[str],
) -> Runs:
    """Return the stored runs by role."""
    runs: Runs = {"fit": [], "held_out": []}
    for each in wanted:
        if each.run_id in stored:
            kind = each.spec.trajectory.kind
            role = "held_out" if kind == asked.held_out else "fit"
            runs[role].append(each.run_id)
    if not runs["fit"]:
        why = failed[0] if failed else f"all motions are '{asked.held_out}', held out"
        raise RunError(f"{asked.path} has no run to fit: {why}.")
    return runs


def _run(spec: ExperimentSpec, store: str, campaign: str | None) -> str:
    return experiment.run(spec, store_folder(store), campaign)


def _checked(planned: Planned, run_id: str, store: Path) -> Exception | None:
    # A process loads the code anew, and the id of a run is also that of its code.
    if run_id != planned.run_id:
        return RunError(f"stored as {run_id}: the code was changed since the start")
    if not experiment.is_stored(store, planned.spec, run_id):
        return RunError(
            f"stored elsewhere than in {shown(store)}: a cluster needs a store on "
            "object storage (--store s3://BUCKET/PREFIX), or a file system that all "
            "its machines share"
        )
    return None


def _failure(planned: Planned, error: BaseException) -> Failure:
    return Failure(planned, " ".join(str(error).split()))


Workers = Pool | Here | Cluster


# Many arms: their campaigns and their diagnoses over processes or a cluster.
#
# What goes to a worker is the name of the store and ids, and ids come back: with a
# store on object storage the machines share no disk.


@dataclass(frozen=True, slots=True)
class Arm:
    """One arm of a fleet.

    Attributes:
        label: What people call it.
        runs: Ids of its runs by role: fit, and held_out where there are such.
    """

    label: str
    runs: Mapping[str, Sequence[str]]


@dataclass(frozen=True, slots=True)
class Diagnosed:
    """What became of the diagnosis of an arm.

    Attributes:
        label: What people call it.
        diagnosis: Its id, None if it failed.
        why: Why it failed, "" if it did not.
    """

    label: str
    diagnosis: str | None
    why: str = ""


def arms_of(
    words: Iterable[str],
    held_out: str,
    store: Path,
    pool: Workers,
    tell: Progress | None = None,
) -> tuple[list[Arm], list[str]]:
    """Run the campaigns of a fleet, all at once, and return its arms.

    Args:
        words: A campaign file, or ids of runs with commas between them, for each arm.
        held_out: Kind of motion of a campaign that is held out, "" for none.
    """
    asked = {w: Campaign(w, held_out, store=store) for w in words if Path(w).is_file()}
    wanted = {word: planned(campaign) for word, campaign in asked.items()}
    every = {each.run_id: each for found in wanted.values() for each in found}
    summary = run_all(list(every.values()), store, tell, pool)
    failed = [f"{f.planned.label}: {f.why}" for f in summary.failures]
    arms = []
    for word in words:
        if word in asked:
            runs = by_role(asked[word], wanted[word], summary.stored, failed)
        else:
            runs = _named(word, store)
        arms.append(Arm(word, runs))
    return arms, failed


def diagnose_arms(
    arms: Sequence[Arm], store: Path, pool: Workers, tell: Progress | None = None
) -> list[Diagnosed]:
    """Diagnose every arm, each against the model that it has.

    Returns:
        What became of each, in their order; a failure is in it and raises nothing.
    """
    jobs = [partial(_diagnose, dict(arm.runs), shown(store)) for arm in arms]
    out: list[Diagnosed | None] = [None] * len(arms)
    for count, done in enumerate(pool.run(plainly, jobs), start=1):
        label = arms[done.index].label
        if done.error:
            why = " ".join(str(done.error).split())
            out[done.index] = Diagnosed(label, None, why)
        else:
            out[done.index] = Diagnosed(label, done.value)
        if tell:
            tell(f"diagnosed {count} of {len(arms)}: {label}", count / len(arms))
    return [each for each in out if each]


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
