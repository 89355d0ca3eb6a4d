"""Many arms: their campaigns and their diagnoses over processes or a cluster.

What goes to a worker is the name of the store and ids, and ids come back: with a store
on object storage the machines share no disk.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from flows.errors import RunError
from flows.inputs.robots import instead, robot_of
from flows.outputs import Progress
from flows.requests import Campaign
from flows.settings import store_folder
from flows.steps.campaign import Runs, by_role, planned, run_all
from flows.steps.diagnose import diagnose_runs, request_of
from flows.steps.loop.choose import in_force
from flows.workers.pool import Here, Pool
from flows.workers.runner import Cluster
from residual.errors import InputError, ModelgapError
from warehouse.layout import find_run
from warehouse.objects.mirror import shown
from warehouse.robots import robot_word
from warehouse.runs import read_manifest

Workers = Pool | Here | Cluster


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
        tell: Told what is done and the share of it.

    Raises:
        InputError: If a word is neither, or a campaign is not usable.
        RunError: If an arm has no run to fit.
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

    Args:
        tell: Told what is done and the share of it.

    Returns:
        What became of each, in their order; a failure is in it and raises nothing.
    """
    jobs = [(dict(arm.runs), shown(store)) for arm in arms]
    out: list[Diagnosed | None] = [None] * len(arms)
    for count, done in enumerate(pool.run(_diagnose, jobs), start=1):
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


def _diagnose(job: tuple[Runs, str]) -> str:
    """Diagnose one arm; whatever it raises can cross to the parent process."""
    runs, word = job
    try:
        store = store_folder(word)
        with instead(_robots(runs, store)):
            model = in_force(runs["fit"], store).diagnosis
            return diagnose_runs(request_of(runs, store, model))[0]
    except ModelgapError as error:
        raise InputError(str(error)) from None
    except Exception as error:
        raise RunError(f"{type(error).__name__}: {error}") from error


def _robots(runs: Runs, store: Path) -> dict[str, str]:
    """Return where to load the robot from: its file may be on another machine."""
    word = robot_of(runs["fit"], store)
    hash = read_manifest(store, runs["fit"][0]).get("robot_hash")
    return {word: robot_word(store, word, hash)}
