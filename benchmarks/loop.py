"""Does the loop close: is an arm driven better by the model that a diagnosis found?

    python benchmarks/loop.py --quick           under 50 s on two cores
    python benchmarks/loop.py --groups tracking
    python benchmarks/loop.py --groups next --seeds 1:4         to look at
    python benchmarks/loop.py --full-json OUT       benchmarks/results/...

The group next has seeds of its own that decide (126101:126116) and are used for
nothing else; 1 to 99 are for development. Its finished cases are kept in
store/benchmarks, by a hash of the code: an interrupted run goes on where it was. The
last line is one JSON object; exit code 1 for a missed bar.
"""

import argparse
import sys
from functools import partial
from importlib import import_module
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.cases import kept_file, run_kept, seed_range
from benchmarks.harness.figures import Figures, all_missing, function_of, run_groups
from flows.workers.processes import Processes

GROUPS = {name: f"loop_parts.{name}:figures_of" for name in ("tracking", "next")}
# Of many drawn cases; the figures that a quick run leaves to the full one.
_SEEDED = {
    "next": {
        "next_settled": 0.80,
        "next_random_over_designed": 2.5,
        "next_nats_within_two": 0.80,
        "next_beyond_limits": 0,
    },
}


def main() -> int:
    own = argparse.ArgumentParser(add_help=False)
    text = "of next, both included; without it those that decide"
    own.add_argument("--seeds", metavar="A:B", help=text)
    args, _ = own.parse_known_args()
    return run_groups(__doc__, GROUPS, partial(_measure, args.seeds), own)


def _measure(asked: str | None, name: str, quick: bool) -> Figures:
    if name not in _SEEDED:
        return function_of(GROUPS[name])(quick)
    if quick:
        why = "minutes for each case; the full run measures it"
        return all_missing(_SEEDED[name], why)
    part = import_module(f"benchmarks.loop_parts.{name}")
    seeds = seed_range(asked) if asked else part.SEEDS
    parts = f"benchmarks/loop_parts/{name}.py", "flows/steps/next.py"
    place = kept_file(f"loop-{name}", *parts)
    with Processes(2) as pool:
        rows = run_kept(place, part.words, pool, part.run, part.jobs(seeds))
    return part.figures_of(list(rows.values()), seeds == part.SEEDS)


if __name__ == "__main__":
    sys.exit(main())
