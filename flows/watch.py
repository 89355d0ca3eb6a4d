"""What is done night by night, as plain steps: a campaign, its diagnosis, a report."""

from pathlib import Path

from flows import study
from flows.campaign import Tell, run_all
from flows.design import load_campaign
from flows.errors import RunError
from flows.experiment import plan
from flows.records import read_outcome, store_report
from flows.steps import verdict_json
from residual.errors import InputError

Runs = dict[str, list[str]]


def run_campaign(
    path: str, held_out: str, seed: int, store: Path, tell: Tell | None = None
) -> tuple[Runs, list[str]]:
    """Run a campaign under another seed.

    Args:
        path: The campaign file.
        held_out: Kind of motion of the runs that are held out.
        seed: Replaces the seed of the file.
        store: The store.
        tell: Told what is done.

    Returns:
        Ids of the runs by role, fit and held_out; and what failed, in words.

    Raises:
        InputError: If the campaign is not usable, or of several robots.
        RunError: If too few of its runs succeeded for a diagnosis.
    """
    entries = load_campaign(path, seed)
    robots = {entry.spec.robot for entry in entries}
    if len(robots) > 1:
        raise InputError(f"{path} has {len(robots)} robots; a diagnosis is of one.")
    planned = plan(((e.label, e.spec) for e in entries), store)
    summary = run_all(planned, store, tell)
    failed = [f"{f.planned.label}: {f.why}" for f in summary.failures]
    stored = [p for p in planned if p.run_id in summary.stored]
    runs: Runs = {"fit": [], "held_out": []}
    for each in stored:
        kind = each.spec.trajectory.kind
        runs["held_out" if kind == held_out else "fit"].append(each.run_id)
    if not runs["fit"]:
        why = failed[0] if failed else f"all its motions are '{held_out}', held out"
        raise RunError(f"{path} has no run to fit: {why}.")
    return runs, failed


def diagnose(runs: Runs, store: Path) -> tuple[str, str]:
    """Diagnose runs of the store, which are of one robot.

    Returns:
        The ids of the diagnosis and of its proof.
    """
    from warehouse.manifest import read_manifest

    robot = read_manifest(store, runs["fit"][0])["robot"]
    asked = study.Study(robot, tuple(runs["fit"]), tuple(runs["held_out"]))
    return study.diagnose(asked, store)


def report(ids: tuple[str, str], store: Path) -> tuple[Path, str]:
    """Write the page of a diagnosis into the store.

    Args:
        ids: Of the diagnosis and of its proof.
        store: The store.

    Returns:
        The page, and the verdict in a few sentences.
    """
    from flows.report.html import render
    from flows.report.words import sentences

    outcome = read_outcome(store, ids[1])
    robot = outcome.verdict["robot"]
    files = {
        "report.html": render(outcome, robot).encode(),
        "verdict.json": verdict_json(outcome.verdict).encode(),
    }
    folder = store_report(store, {"robot": robot, "kind": "nightly"}, ids[0], files)
    return folder / "report.html", " ".join(sentences(outcome.verdict))
