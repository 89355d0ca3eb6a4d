"""Is the whole set of changed values named, and nothing else?

    python benchmarks/attribution.py --quick                     under 50 s on two cores
    python benchmarks/attribution.py --seeds 1:2 --groups sets      to look at
    python benchmarks/attribution.py --full-json benchmarks/results/attribution.json

Arms of six and of seven joints whose given inertias, friction and rotors are exact or 1
or 3 % off. `unchanged`: nothing else is off, and any name is false. `sets`: a load,
links 8 to 25 % off and friction, each of 2 % of a joint's torque or more. Seeds
154201:154208 decide and are used for nothing else; 1 to 99 are for development.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.attribution_parts import bars, cases
from benchmarks.harness import cases as harness
from benchmarks.harness.figures import finish

_SEEDS = "154201:154208"


def main() -> int:
    args = harness.read_options(__doc__, _SEEDS, cases.GROUPS)
    seeds = harness.seed_range(args.seeds)
    tasks = {group: cases.tasks(group, seeds, args.quick) for group in args.groups}
    path = harness.kept_file("attribution", "benchmarks/attribution_parts")
    jobs = {task.name: task for group in tasks.values() for task in group}
    done = harness.run_kept(
        path, cases.summary, cases.run, jobs, processes=args.processes
    )
    rows = {group: [done[t.name] for t in tasks[group]] for group in args.groups}
    figures = bars.case_figures(rows, args.deciding)
    harness.save_rows(args, figures, cases=rows)
    return finish(figures)


if __name__ == "__main__":
    sys.exit(main())
