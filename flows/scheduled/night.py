"""What is done night by night, as plain steps: a campaign, its diagnosis, a report."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flows.errors import RunError
from flows.keep.diagnosis import read_outcome, store_report
from flows.specs.campaign import load_campaign
from flows.steps import study
from flows.steps.diagnose import verdict_json
from flows.steps.experiment import Planned, plan
from flows.workers.campaign import Tell, run_all
from flows.workers.pool import Here
from flows.workers.runner import chosen_runner, workers_of
from residual.errors import InputError

Runs = dict[str, list[str]]


@dataclass(frozen=True, slots=True)
class Campaign:
    """A campaign of one arm.

    Attributes:
        path: The campaign file.
        held_out: Kind of motion of the runs that are held out; "" for none.
        seed: Replaces the seed of the file; None for that one.
        runner: Where it is computed; None for the usual place (`flows.workers.runner`).
        trust_network: Whether that may be on other machines.
    """

    path: str
    held_out: str = ""
    seed: int | None = None
    runner: str | None = None
    trust_network: bool = False


def run_experiment(path: str, store: Path) -> str:
    """Run one experiment and store it.

    Args:
        path: SPEC.toml.
        store: The store.

    Returns:
        The id of its run.

    Raises:
        InputError: If it asks for what cannot be.
    """
    from flows.specs.experiment import load_spec
    from flows.steps import experiment

    return experiment.run(load_spec(path), store)


def planned(asked: Campaign, store: Path) -> list[Planned]:
    """Return the experiments of a campaign, and which of them are stored.

    Raises:
        InputError: If the campaign is not usable, or of several robots.
    """
    entries = load_campaign(asked.path, asked.seed)
    robots = {entry.spec.robot for entry in entries}
    if len(robots) > 1:
        raise InputError(f"{asked.path} has {len(robots)} robots; expected one.")
    return plan(((e.label, e.spec) for e in entries), store)


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


def run_campaign(asked: Campaign, store: Path, tell: Tell | None = None) -> Ran:
    """Run what is not in the store.

    Args:
        asked: The campaign.
        store: The store.
        tell: Told what is done.

    Raises:
        InputError: If the campaign is not usable, or of several robots.
        RunError: If too few of its runs succeeded for a diagnosis.
    """
    wanted = planned(asked, store)
    runner = chosen_runner(asked.runner, asked.trust_network)
    with workers_of(runner, sum(not p.stored for p in wanted)) as pool:
        summary = run_all(wanted, store, tell, pool)
    failed = tuple(f"{f.planned.label}: {f.why}" for f in summary.failures)
    known = {p.run_id for p in wanted if p.stored}
    new = tuple(id for id in summary.stored if id not in known)
    return Ran(by_role(asked, wanted, summary.stored, failed), new, failed)


def run_part(path: str, seed: int | None, ids: Sequence[str], store: Path) -> list[str]:
    """Run some experiments of a campaign in this process; return what failed.

    Args:
        path: The campaign file.
        seed: Replaces the seed of the file; None for that one.
        ids: Which: the ids that their runs will have.
        store: The store.
    """
    part = [p for p in planned(Campaign(path, seed=seed), store) if p.run_id in ids]
    summary = run_all(part, store, pool=Here())
    return [f"{f.planned.label}: {f.why}" for f in summary.failures]


def by_role(
    asked: Campaign,
    wanted: Sequence[Planned],
    stored: Sequence[str],
    failed: Sequence[str],
) -> Runs:
    """Return the stored runs by role.

    Args:
        asked: The campaign.
        wanted: Its experiments.
        stored: Ids of the runs that are in the store.
        failed: What failed, in words.

    Raises:
        RunError: If none is left to fit.
    """
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


def diagnose(runs: Runs, store: Path) -> tuple[str, str]:
    """Diagnose runs of the store, which are of one robot.

    Args:
        runs: Ids by role: fit, held_out, and baseline for those in good order.
        store: The store.

    Returns:
        The ids of the diagnosis and of its proof.
    """
    from flows.scheduled.stages import robot_of

    roles = {role: tuple(ids) for role, ids in runs.items()}
    asked = study.Study(robot_of(runs["fit"], store), **roles)
    return study.diagnose(asked, store)


def report(ids: tuple[str, str], store: Path) -> tuple[Path, str]:
    """Write the page of a diagnosis into the store.

    Args:
        ids: Of the diagnosis and of its proof.
        store: The store.

    Returns:
        The page, and the verdict in a few sentences.
    """
    from flows.report.page.diagnosis import render
    from flows.report.words.verdict import sentences

    found = read_outcome(store, ids[1])
    robot = found.verdict.robot
    files = {
        "report.html": render(found, robot).encode(),
        "verdict.json": verdict_json(found.verdict).encode(),
    }
    folder = store_report(store, {"robot": robot, "kind": "nightly"}, ids[0], files)
    return folder / "report.html", " ".join(sentences(found.verdict))
