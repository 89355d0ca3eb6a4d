"""Group 4: kill -9 at random moments of a campaign, then resume it.

Everything is real but the physics: the campaign file is loaded and planned, and each
experiment is run, sealed and stored by the code of `modelgap campaign`. In place of the
simulated arm stand arrays that its spec decides.
"""

import random
from pathlib import Path
from time import perf_counter, sleep

import warehouse
from benchmarks.harness.figures import Figures, all_partial, figure
from benchmarks.harness.shell import forked
from benchmarks.store_parts.made import folder, stand_in
from flows.specs.campaign import load_campaign
from flows.steps import experiment
from flows.steps.campaign import run_all
from flows.workers.processes import InlineExecutor
from warehouse.layout import list_folders
from warehouse.provenance import provenance
from warehouse.runs import open_seal, read_run

RUNS, ROWS, FULL = 12, 400, 200
# So many kills meet one store, so that every stage of a campaign is met.
PER_STORE = 5
CAMPAIGN = f"""
schema = 1
robot = "irb140"
[trajectory]
kind = "fourier"
duration = 4.0
[[plant.effect]]
name = "stribeck"
joints = [3]
level = 4.0
velocity = 0.05
[grid]
seed = {list(range(RUNS))}
"""

provenance()  # slow the first time, and the same in every process forked from here


def kill_figures(quick: bool, kills: int | None = None) -> Figures:
    """Kill campaigns, look at their stores, resume them, and compare what there is."""
    kills = kills or (8 if quick else FULL)
    context = forked(__name__)
    rng = random.Random(5)
    with folder() as place:
        spec = place / "campaign.toml"
        spec.write_text(CAMPAIGN)
        start = perf_counter()
        _campaign(spec, place / "calm")
        whole = perf_counter() - start
        wanted = _content(place / "calm")
        seen, bad = [], []
        for kill in range(kills):
            store = place / f"killed-{kill // PER_STORE}"
            _kill(context, (spec, store), rng.uniform(0, 1.2 * whole))
            found, wrong = _check(store)
            seen.append(found)
            bad += wrong
        stores = sorted(place.glob("killed-*"))
        for store in stores:
            _campaign(spec, store)
        other = [s.name for s in stores if _content(s) != wanted]
    about = {"stages_met": len(set(seen)), "campaign_s": round(whole, 2)}
    figures = {
        "kill_inconsistent_stores": figure(len(bad), 0, kills, told=bad[:3], **about),
        "kill_resumed_otherwise": figure(len(other), 0, len(stores), told=other[:3]),
    }
    why = f"{kills} kills instead of {FULL}" if kills < FULL else ""
    return all_partial(figures, why)


def _kill(context, arguments: tuple, after: float) -> None:
    started = context.Event()
    process = context.Process(target=_campaign, args=(*arguments, started))
    process.start()
    started.wait(60)
    sleep(after)
    process.kill()
    process.join()


def _campaign(spec: Path, store: Path, started=None) -> None:
    experiment._simulate = stand_in(lambda spec: spec.seed, ROWS)
    if started is not None:
        started.set()
    planned = experiment.plan(load_campaign(spec), store)
    summary = run_all(planned, store, None, InlineExecutor())
    for why in summary.failed.values():
        raise RuntimeError(why)


def _check(store: Path) -> tuple[int, list[str]]:
    """Return how many runs there are, and what is wrong with them."""
    store.mkdir(exist_ok=True)
    wrong = []
    with warehouse.open(store) as opened:
        rows = opened.sql(
            "SELECT run_id, count(t) AS n FROM runs LEFT JOIN samples USING (run_id) "
            "GROUP BY run_id"
        ).to_pylist()
        wrong += opened.damaged
    wrong += [row["run_id"] for row in rows if row["n"] != ROWS]
    if {row["run_id"] for row in rows} != set(list_folders(store, "runs")):
        wrong.append("a run is not listed")
    for row in rows:
        try:
            read_run(store, row["run_id"])
            open_seal(store, row["run_id"])
        except Exception as error:
            wrong.append(str(error))
    return len(rows), wrong


def _content(store: Path) -> list:
    """Every value that a campaign stores, but for the times of the commits."""
    with warehouse.open(store) as opened:
        tables = [
            opened.sql(f"SELECT * EXCLUDE ({out}) FROM {view} ORDER BY ALL").to_pydict()
            for view, out in (
                ("runs", "created"),
                ("errors", "stage"),
                ("samples", "e_q6"),
            )
        ]
    seals = [open_seal(store, id) for id in sorted(list_folders(store, "runs"))]
    hidden = [(s.spec, {k: v.tobytes() for k, v in s.truth.items()}) for s in seals]
    return [repr(tables), repr(hidden)]
