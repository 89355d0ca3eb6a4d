"""The demonstration's command, and its steps without Prefect over many seeds."""

import os
import shutil
import tempfile
from pathlib import Path
from time import perf_counter

from benchmarks.harness.cases import STORE, guarded
from benchmarks.harness.figures import FEW, Figures, figure, missing
from benchmarks.harness.shell import run_shell
from flows.blind.sums import wilson
from flows.steps import demo
from flows.steps.demo import Demo
from flows.steps.diagnose import diagnose_runs, request_of
from flows.storage.diagnosis import read_outcome
from flows.workers.pool import Here
from residual.diagnosis.result import Verdict

SECONDS, GIGABYTES = 90.0, 1.5
# Of twenty demonstrations and ten nulls.
BARS = {"plain_right": 16, "plain_wrong": 1, "nulls_named": 0}


def command_figures() -> Figures:
    """Time `modelgap demo` in an empty store, with the memory of all its processes."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["demo", "--store", str(Path(folder) / "store")]
        ran = run_shell(words, folder, tree=True)
        made = list(Path(folder).glob("store/reports/*/report.html"))
    if ran.code or not made:
        failed = {"ok": False}
        return {
            "demo_seconds": missing(SECONDS, ran.failure) | failed,
            "demo_peak_gb": missing(GIGABYTES, ran.failure) | failed,
        }
    seconds, peak = round(ran.seconds, 1), round(ran.gigabytes, 3)
    return {
        "demo_seconds": figure(seconds, SECONDS, 1, cores=os.cpu_count()),
        "demo_peak_gb": figure(peak, GIGABYTES, 1, of="all its processes"),
    }


def run_seed(task: tuple[int, str | None]) -> dict:
    """Run one demonstration in a store of its own and judge the verdict.

    Args:
        task: Seed, and effect: None to draw it, "none" for a null.

    Returns:
        Truth, findings and score: "right", "wrong", "nothing" or "crash".
    """
    seed, effect = task
    # Kept until it is judged, so that an interrupted seed goes on with its runs.
    store = STORE / f"demo-{seed}-{effect or 'drawn'}"
    try:
        return guarded(crashed(task), lambda: _judged(Demo(seed, effect, store), store))
    finally:
        shutil.rmtree(store, ignore_errors=True)


def crashed(task: tuple[int, str | None]) -> dict:
    """Return the record of a demonstration that did not come to its end."""
    seed, effect = task
    null = effect == demo.NOTHING
    return {"seed": seed, "null": null, "truth": None, "score": "crash"}


def _judged(asked: Demo, store: Path) -> dict:
    begun = perf_counter()
    runs = demo.run_experiments(asked, pool=Here())
    ran = perf_counter()
    diagnosis, proof = diagnose_runs(request_of(runs, store))
    done = perf_counter()
    hidden = demo.open_seal(runs, diagnosis, store)
    verdict = read_outcome(store, proof).verdict
    truth = [hidden[0]["name"], sorted(hidden[0]["joints"])] if hidden else None
    return {
        "seed": asked.seed,
        "null": asked.effect == demo.NOTHING,
        "truth": truth,
        "size": hidden[0]["parameters"] if hidden else {},
        **judge(truth, verdict),
        "overall": verdict.error.overall_filtered,
        "seconds": [round(ran - begun, 1), round(done - ran, 1)],
    }


def judge(truth: list | None, verdict: Verdict) -> dict:
    """Score a verdict.

    Right: the first finding is the truth, or the truth is among its equivalents. Wrong:
    there is a first finding and it is not that. For a truth out of the vocabulary
    ("x_..."), right is a flag on its joint without a name. Further names are extra.

    Args:
        truth: Name and joints, None for a null case.
    """
    found = verdict.effects
    names = [_key(e.name, e.joints) for e in found]
    flagged = list(verdict.unexplained.joints)
    unnamed = truth is not None and truth[0].startswith("x_")
    if truth is None or unnamed:
        seen = bool(unnamed and truth[1][0] in flagged)
        score = "wrong" if names else "right" if truth is None or seen else "nothing"
        extra = names[1:]
    elif not names:
        score, extra = "nothing", []
    else:
        classes = [_key(e.name, e.joints) for e in found[0].equivalent]
        score = "right" if truth in [names[0], *classes] else "wrong"
        extra = [name for name in names[1:] if name != truth]
    shown = [
        [*_key(e.name, e.joints), e.evidence.by, e.evidence.nats, e.evidence.held_out]
        for e in found
    ]
    return {
        "score": score,
        "first": names[0] if names else None,
        "exact": bool(names) and names[0] == truth,
        "extra": extra,
        "found": shown,
        "verdict": verdict.verdict,
        "unexplained": flagged,
        "warnings": list(verdict.warnings),
    }


def _key(name: str, joints: object) -> list:
    return [name, sorted(int(j) for j in joints)]


def pipeline_figures(records: list[dict], deciding: bool) -> Figures:
    """Return right and wrong first names, false alarms and crashes.

    Args:
        records: Judged demonstrations.
        deciding: Whether these are the seeds that the bars are for.
    """
    hidden = [r for r in records if not r["null"]]
    nulls = [r for r in records if r["null"]]
    n = len(hidden)
    right, wrong = (sum(r["score"] == s for r in hidden) for s in ("right", "wrong"))
    named = sum(r["score"] == "wrong" for r in nulls)
    exact = sum(bool(r.get("exact")) for r in hidden)
    crashes = sum(r["score"] == "crash" for r in records)
    at_least = {"ok": right >= BARS["plain_right"], "at_least": True}
    figures = {
        "plain_right": figure(right, BARS["plain_right"], n, interval=wilson(right, n))
        | at_least,
        "plain_wrong": figure(wrong, BARS["plain_wrong"], n, interval=wilson(wrong, n)),
        "nulls_named": figure(
            named, BARS["nulls_named"], len(nulls), interval=wilson(named, len(nulls))
        ),
        "plain_right_by_name": figure(exact, None, n, why="for information"),
        "crashes": figure(crashes, 0, len(records)),
    }
    if not deciding:
        for name in BARS:
            figures[name] |= {"ok": None, "why": FEW}
    return figures


def show_line(record: dict) -> str:
    """Return one demonstration in a line."""
    truth = "nothing" if record["null"] else f"{record['truth']}"
    names = [f"{f[0]} {f[1]} ({f[2]}, {f[3]:.0f} nats)" for f in record["found"]]
    told = "; ".join(names) or f"nothing (unexplained {record['unexplained']})"
    seconds = "+".join(f"{s:g}" for s in record["seconds"])
    return f"seed {record['seed']}: {record['score']}: {truth} -> {told} ({seconds} s)"
