"""What changed between an earlier state of an arm and its new logs: is it found?

    python benchmarks/changes.py --quick                     a case of each group
    python benchmarks/changes.py --seeds 1:1 --groups change
    python benchmarks/changes.py --full-json benchmarks/results/changes.json

The size of a change is the RMS of its torque over that of the joint, not a multiple of
what the program says. Silence is a miss. Seeds 154301:154303 decide and are used for
nothing else; 1 to 99 are for development. The peer, a plain regression of both epochs,
gets the same cases in the same run.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.changes_parts import answers, bars, draw
from benchmarks.harness import cases as harness
from benchmarks.harness.figures import finish

_SEEDS = "154301:154303"


def main() -> int:
    args = harness.read_options(__doc__, _SEEDS, draw.GROUPS)
    seeds = harness.seed_range(args.seeds)
    jobs = {
        slot.name: slot
        for group in args.groups
        for slot in draw.slots(group, seeds, args.quick)
    }
    parts = ("benchmarks/changes_parts", "benchmarks/check_parts")
    path = harness.kept_file("changes", *parts)
    done = harness.run_kept(
        path, answers.summary, answers.run, jobs, processes=args.processes
    )
    rows = [r for result in done.values() for r in result.get("rows", [result])]
    figures = bars.all_figures(rows, args.deciding)
    harness.save_rows(args, figures, cases=rows)
    return finish(figures)


if __name__ == "__main__":
    sys.exit(main())
