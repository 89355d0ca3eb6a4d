"""Arms with two effects, from the first experiment to the last decision of the loop.

Every plant is closed with the budget of the command, by motions that are designed for
what is open; one in three also by the standard ones in their order, by the same rule of
stopping. What the arm hides is looked at when the loop has ended.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

from benchmarks.harness.cases import guarded
from benchmarks.harness.figures import Figures, figure, undecided
from benchmarks.harness.rates import at_least, at_most, rate
from flows.blind.score import PAIR, Name, score
from flows.steps.closing.arm import Close
from flows.steps.closing.close import Closed, adopted_verdict, close
from flows.steps.closing.rule import ADOPT, DIAGNOSE

SEEDS = range(130101, 130111)  # of the deciding run
ROBOT, BUDGET, EFFECTS = "irb140", 8, 2
BOTH, FALSE, QUIET = 0.90, 0.0, 0.95
WAYS = {"designed": True, "fixed": False}
FIXED_EVERY = 3  # plants: the order makes no name, and takes the time of another


def jobs(seeds: Sequence[int]) -> dict[str, tuple[int, str]]:
    """Return the cases by name: of every plant, and of some the other way."""
    return {
        f"close {seed} {way}": (seed, way)
        for seed in seeds
        for way in WAYS
        if WAYS[way] or seed % FIXED_EVERY == 0
    }


def run(job: tuple[int, str]) -> dict:
    """Close the loop of one plant one way; a row, or the crash."""
    seed, way = job
    return guarded({"seed": seed, "way": way}, lambda: _row(seed, way))


def _row(seed: int, way: str) -> dict:
    begun = perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "store"
        asked = Close(ROBOT, BUDGET, seed, EFFECTS, store=store, drives=False)
        done = close(replace(asked, designed=WAYS[way]))
        row = _judged(done, store)
    about = {"seed": seed, "way": way, "took": round(perf_counter() - begun, 1)}
    return about | row


def _judged(done: Closed, store: Path) -> dict:
    truths = [Name(h["name"], tuple(h["joints"])) for h in done.hidden]
    given = [d for d in done.decisions if d.action == ADOPT and d.made]
    scores = [score(PAIR, truths, adopted_verdict(store, d.result)) for d in given]
    last = given[-1].number if given else 0
    looks = [d for d in done.decisions if d.action == DIAGNOSE and d.result["model"]]
    next_look = next((d for d in looks if d.number > last), None)
    return {
        "hidden": [str(name) for name in truths],
        "adopted": list(done.known.adopted["effects"]) if given else [],
        "found": scores[-1].found if given else 0,
        # Of any adoption: what was taken back later was believed for a while.
        "extra": max((s.extra for s in scores), default=0),
        "quiet": next_look and next_look.result["verdict"] == "none",
        "ended": done.decisions[-1].result["why"],
        "reason": done.decisions[-1].reason,
        "experiments": len(done.known.runs),
        "designed": sum(d.result["designed"] for d in done.known.runs),
        "seconds": done.seconds,
    }


def words(row: Mapping) -> str:
    """Return a row as it is printed."""
    hidden, adopted = (", ".join(row[k]) or "nothing" for k in ("hidden", "adopted"))
    return (
        f"{row['found']} of {len(row['hidden'])}, {row['extra']} false: {hidden} -> "
        f"{adopted}; {row['ended']}, {row['seconds']:.0f} s of motion, "
        f"{row['designed']} of {row['experiments']} designed ({row['took']:.0f} s)"
    )


def figures_of(rows: Sequence[Mapping], deciding: bool) -> Figures:
    """Return the figures of some rows.

    Args:
        deciding: Whether these are all of the seeds that decide.
    """
    whole = [r for r in rows if "error" not in r]
    done = [r for r in whole if r["way"] == "designed"]
    looked = [r for r in done if r["quiet"] is not None]
    figures = {
        "close_both_adopted": at_least(
            rate(done, lambda r: r["found"] == EFFECTS), BOTH
        ),
        "close_false_adopted": at_most(rate(done, lambda r: r["extra"] > 0), FALSE),
        "close_quiet_after": at_least(rate(looked, lambda r: r["quiet"]), QUIET),
        "close_ended_sure": at_least(
            rate(done, lambda r: r["ended"] == "nothing left"), None
        ),
        "close_seconds_over_fixed": _seconds(whole),
        "close_crashes": figure(len(rows) - len(whole), 0, len(rows)),
    }
    return figures if deciding else undecided(figures)


def _seconds(rows: Sequence[Mapping]) -> dict:
    """Motion of all plants with designed motions, over that in the fixed order."""
    by = {way: {r["seed"]: r for r in rows if r["way"] == way} for way in WAYS}
    both = sorted(set(by["designed"]) & set(by["fixed"]))
    ours, theirs = (sum(by[way][s]["seconds"] for s in both) for way in WAYS)
    found = [sum(by[way][s]["found"] for s in both) for way in WAYS]
    value = ours / theirs if theirs else None
    entry = figure(value, 1.0, len(both), seconds=[ours, theirs], found=found)
    return entry | {"ok": None if value is None else value < 1}
