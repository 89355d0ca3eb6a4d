"""Does the check find faults of logs, repair them, and accept sound logs?

    python benchmarks/check.py --quick                    under 50 s on two cores
    python benchmarks/check.py --seeds 1:2                to look at
    python benchmarks/check.py --full-json benchmarks/results/check.json

Every kind of fault is put at three sizes into logs of simulated and measured arms.
Sound logs include arms with every effect, and logs in which a joint is held. Seeds
154401:154401 decide and are used for nothing else; 1 to 99 are for development.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.check_parts import bars, cases
from benchmarks.harness import cases as harness
from benchmarks.harness.figures import finish

_SEEDS = "154401:154401"
_GROUPS = ("faults", "clean", "effects")


def main() -> int:
    args = harness.read_options(__doc__, _SEEDS, _GROUPS)
    tasks = cases.tasks(harness.seed_range(args.seeds), args.quick)
    jobs = {task.name: task for task in tasks if task.group in args.groups}
    parts = ("benchmarks/check_parts", "flows/inputs", "flows/steps")
    path = harness.kept_file("check", *parts)
    done = harness.run_kept(
        path, cases.summary, cases.run, jobs, processes=args.processes
    )
    rows = [row for result in done.values() for row in result.get("rows", ())]
    lost = [{"error": r["error"], "group": n} for n, r in done.items() if "error" in r]
    figures = bars.figures([*rows, *lost], args.whole)
    harness.save_rows(args, figures, cases=rows)
    return finish(figures)


if __name__ == "__main__":
    sys.exit(main())
