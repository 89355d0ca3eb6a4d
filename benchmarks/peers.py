"""Other programs on the same hidden effects: what does each name, and is it right?

    python benchmarks/peers.py --quick                          two short cases
    python benchmarks/peers.py --seeds 1:1 --groups squares sparse      to look at
    python benchmarks/peers.py --full-json benchmarks/results/peers.json

Each seed is ten cases in the physics engine, of the built-in arm for odd seeds, of a
drawn one for even ones. The programs are ours, plain least squares, and a sparse
selection written from the description of SAPC, not that program. Seeds 154501:154502
decide and are used for nothing else; 1 to 99 are for development.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness import cases as harness
from benchmarks.harness.figures import finish
from benchmarks.peers_parts import bars, cases

_SEEDS = "154501:154502"
_FULL, _QUICK = (10, 20.0), (2, 8.0)  # cases, seconds of a log


def main() -> int:
    args = harness.read_options(__doc__, _SEEDS, tuple(cases.PROGRAMS))
    path = harness.kept_file("peers", "benchmarks/peers_parts")
    count, seconds = _QUICK if args.quick else _FULL
    seeds, programs = harness.seed_range(args.seeds), tuple(args.groups)
    arms = {seed: cases.Task(seed, cases.BENCH, seconds) for seed in seeds}
    nulls = {t.name: t for t in arms.values()}
    sizes = harness.run_kept(
        path, cases.summary, cases.run, nulls, processes=args.processes
    )
    tasks = [
        cases.Task(
            seed, number, seconds, programs, tuple(sizes[arm.name].get("minimum", ()))
        )
        for seed, arm in arms.items()
        for number in range(count)
    ]
    done = harness.run_kept(
        path,
        cases.summary,
        cases.run,
        {t.name: t for t in tasks},
        processes=args.processes,
    )
    rows = {
        program: [done[t.name].get(program, done[t.name]) for t in tasks]
        for program in programs
    }
    figures = bars.all_figures(rows)
    harness.save_rows(args, figures, cases=rows)
    return finish(figures)


if __name__ == "__main__":
    sys.exit(main())
