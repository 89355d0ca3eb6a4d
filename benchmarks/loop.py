"""Does one designed experiment settle what a first verdict left open, and how soon?

    python benchmarks/loop.py --seeds 1:4       to look at; minutes for each case
    python benchmarks/loop.py --full-json benchmarks/results/loop.json

Seeds 154601:154608 decide and are used for nothing else; 1 to 99 are for development. A
case takes minutes, so that a quick run measures nothing.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness import cases as harness
from benchmarks.harness.figures import FULL, all_missing, finish
from benchmarks.loop_parts import next as part

_SEEDS = "154601:154608"


def main() -> int:
    args = harness.read_options(__doc__, _SEEDS, ("next",))
    if args.quick:
        return finish(all_missing(part.BARS, FULL))
    path = harness.kept_file("loop", "benchmarks/loop_parts", "flows/steps/next.py")
    jobs = {f"next {seed}": seed for seed in harness.seed_range(args.seeds)}
    rows = list(
        harness.run_kept(
            path, part.summary, part.run, jobs, processes=args.processes
        ).values()
    )
    figures = part.figures_of(rows, args.deciding)
    harness.save_rows(args, figures, cases=rows)
    return finish(figures)


if __name__ == "__main__":
    sys.exit(main())
