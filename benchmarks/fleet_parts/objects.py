"""A store on object storage: writers at once, kills, ten thousand runs, what it costs.

The server is moto in a process of its own, on this machine. The runs are synthetic
samples of six joints, put in by the program's own commit; nothing is simulated.
"""

import tempfile
from pathlib import Path

from benchmarks.figures import Figures, figure, missing, partial
from benchmarks.fleet_parts.objects_server import serve
from benchmarks.fleet_parts.objects_work import (
    killed,
    one_winner,
    paired_commits,
    timed_questions,
)

WRITERS, TOGETHER, KILLS, MANY, PAIRS = 8, 50, 200, 10_000, 40
_SMALL = "a quick run has fewer"


def figures_of(quick: bool) -> Figures:
    """Measure the group."""
    share = 20 if quick else 1
    with tempfile.TemporaryDirectory() as folder, serve(Path(folder)) as new_store:
        together = TOGETHER // share
        won = one_winner(new_store(), WRITERS, together)
        print(f"{WRITERS} writers x {together} runs: winners {sorted(set(won))}")
        kills = KILLS // share
        partly, seen = killed(new_store(), kills)
        print(f"{kills} kills: {seen} runs stored, {partly} partial")
        count = 120 if quick else MANY
        times = timed_questions(new_store(), count)
        print(f"{count} runs: {times}")
        pairs = PAIRS // (4 if quick else 1)
        costs = paired_commits(new_store(), pairs)
        print(f"commit {costs.commit:.3f} s, put of the same bytes {costs.put:.3f} s")
    made = {
        "object_winners_per_run": figure(
            max(won), 1, together, ok=set(won) == {1}, writers=WRITERS
        ),
        "object_partial_after_kills": figure(partly, 0, kills, runs=seen),
        "object_list_s": figure(times["list"], 1.0, count, again=times["list_again"]),
        "object_errors_s": figure(times["errors"], 2.0, count),
        "object_commit_ratio": figure(
            costs.ratio, 2.0, pairs, commit_s=costs.commit, put_s=costs.put
        ),
        "object_commit_over_parquet_and_put": figure(costs.over_parquet, None, pairs),
    }
    if not quick:
        return made
    out = {name: partial(entry, _SMALL) for name, entry in made.items()}
    for name in ("object_list_s", "object_errors_s"):
        out[name] = missing(made[name]["bar"], f"{count} runs only")
    return out
