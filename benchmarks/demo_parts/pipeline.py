"""The demonstration's steps without Prefect, over many seeds: is the answer right?"""

import shutil
from pathlib import Path
from time import perf_counter

from benchmarks.demo_parts.judge import judge, told
from benchmarks.figures import ROOT, Figures, figure
from flows.blind.sums import wilson
from flows.requests import Demo
from flows.steps import demo
from flows.steps.diagnose import diagnose_runs, request_of
from flows.storage.diagnosis import read_outcome
from flows.workers.pool import Here

RIGHT_OF_20, WRONG_OF_20 = 16, 1
_FEW = "not the deciding seeds; the full run decides"


def run_seed(task: tuple[int, str | None]) -> dict:
    """Run one demonstration in a store of its own and judge the verdict.

    Args:
        task: Seed, and effect: None to draw it, "none" for a null.

    Returns:
        Truth, findings and score: "right", "wrong", "nothing" or "crash".
    """
    seed, effect = task
    record: dict = {"seed": seed, "null": effect == demo.NOTHING}
    # Kept until it is judged, so that an interrupted seed goes on with its runs.
    store = ROOT / "store" / "benchmarks" / f"demo-{seed}-{effect or 'drawn'}"
    try:
        return record | _judged(Demo(seed, effect, store), store)
    except Exception as error:
        # A benchmark of many cases reports a crash as a result and goes on.
        text = f"{type(error).__name__}: {error}"
        return record | {"truth": None, "score": "crash", "error": text}
    finally:
        shutil.rmtree(store, ignore_errors=True)


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
        "truth": truth,
        "size": hidden[0]["parameters"] if hidden else {},
        **judge(truth, verdict),
        "overall": verdict.error.overall_filtered,
        "seconds": [round(ran - begun, 1), round(done - ran, 1)],
    }


def pipeline_figures(records: list[dict], deciding: bool) -> Figures:
    """Return right and wrong first names, false alarms and crashes.

    Args:
        records: Judged demonstrations.
        deciding: Whether these are the seeds that the bars are for.
    """
    hidden = [r for r in records if not r["null"]]
    nulls = [r for r in records if r["null"]]
    n = len(hidden)
    right = sum(r["score"] == "right" for r in hidden)
    wrong = sum(r["score"] == "wrong" for r in hidden)
    named = sum(r["score"] == "wrong" for r in nulls)
    exact = sum(bool(r.get("exact")) for r in hidden)
    crashes = sum(r["score"] == "crash" for r in records)
    figures = {
        "plain_right": figure(right, RIGHT_OF_20, n, ok=right >= RIGHT_OF_20)
        | {"at_least": True, "interval": wilson(right, n)},
        "plain_wrong": figure(wrong, WRONG_OF_20, n, interval=wilson(wrong, n)),
        "nulls_named": figure(named, 0, len(nulls), interval=wilson(named, len(nulls))),
        "plain_right_by_name": figure(exact, None, n, why="for information"),
        "crashes": figure(crashes, 0, len(records)),
    }
    if not deciding:
        for name in ("plain_right", "plain_wrong", "nulls_named"):
            figures[name] |= {"ok": None, "why": _FEW}
    return figures


def show_line(record: dict) -> str:
    """Return one demonstration in a line."""
    if record["score"] == "crash":
        return f"seed {record['seed']}: crash: {record['error']}"
    truth = "nothing" if record["null"] else f"{record['truth']}"
    seconds = "+".join(f"{s:g}" for s in record["seconds"])
    return (
        f"seed {record['seed']}: {record['score']}: {truth} -> {told(record)} "
        f"({seconds} s)"
    )
