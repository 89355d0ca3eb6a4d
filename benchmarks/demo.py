"""Does the demonstration find what its arm hides, and what does it cost?

    python benchmarks/demo.py --quick                     under 50 s on two cores
    python benchmarks/demo.py --seeds 1:20                to tune on; never 1001:1020
    python benchmarks/demo.py --effect each --seeds 200:223 --nulls 0      all in turn
    python benchmarks/demo.py --full-json benchmarks/results/demo.json

Finished seeds are kept in store/benchmarks, by a hash of the code: an interrupted run
goes on where it was. The last line is one JSON object; exit code 1 for a missed bar.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.demo_parts import pipeline
from benchmarks.harness.cases import (
    Kept,
    kept_file,
    read_options,
    save_rows,
    seed_range,
    seeded_options,
)
from benchmarks.harness.figures import Figures, all_missing, finish, one_blas_thread
from flows.settings import cores
from flows.steps.demo import NOTHING
from flows.workers.pool import Pool
from sim.draw import usual_effects

_SEEDS, _NULLS = "1001:1020", 10
_GROUPS = ("command", "pipeline")
_EACH = "each"  # as --effect: all effects that are drawn unasked, in turn


def main() -> int:
    """Run the groups and return the exit code."""
    args = _arguments()
    figures: Figures = {}
    if "command" in args.groups:
        figures |= pipeline.command_figures()
    records: list[dict] = []
    if args.quick:
        figures |= all_missing(pipeline.BARS, "the full run decides")
    elif "pipeline" in args.groups:
        one_blas_thread()
        records = _run(args)
        drawn = args.effect is None
        deciding = args.seeds == _SEEDS and args.nulls >= _NULLS and drawn
        figures |= pipeline.pipeline_figures(records, deciding)
    save_rows(args, figures, pipeline=records)
    return finish(figures)


def _arguments() -> argparse.Namespace:
    parser = seeded_options(__doc__, _SEEDS, _GROUPS)
    parser.add_argument("--nulls", type=int, default=_NULLS, help="how many")
    parser.add_argument("--effect", help=f"hide this one, or '{_EACH}'")
    return read_options(parser, _SEEDS)


def _run(args: argparse.Namespace) -> list[dict]:
    """Return the record of every seed."""
    seeds = seed_range(args.seeds)
    names = usual_effects() if args.effect == _EACH else [args.effect]
    tasks = [(seed, names[i % len(names)]) for i, seed in enumerate(seeds)]
    tasks += [(seed, NOTHING) for seed in range(seeds[0], seeds[0] + args.nulls)]
    jobs = {f"{seed} {effect or 'drawn'}": (seed, effect) for seed, effect in tasks}
    place = args.keep or kept_file("demo", "flows/steps/demo.py")
    with Pool(cores()) as pool, Kept(place, pipeline.show_line) as known:
        done = known.run(pool, pipeline.run_seed, jobs)
    # What a process took with it has no record of its own.
    return [pipeline.crashed(job) | done[name] for name, job in jobs.items()]


if __name__ == "__main__":
    sys.exit(main())
