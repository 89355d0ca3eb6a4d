"""Does the check find faults of logs, repair them, and accept sound logs?

    python benchmarks/check.py --quick                    under 50 s on two cores
    python benchmarks/check.py --seeds 1:2                to look at
    python benchmarks/check.py --full-json benchmarks/results/check.json

Every kind of fault is put at three sizes into logs of simulated and measured arms.
Robot files have bodies that no link has, or masses of another scale, beside sound logs.
Sound logs include arms with every effect, and logs in which a joint is held. Seeds
166402:166402 decide and are used for nothing else; 1 to 99 are for development.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.check_parts import bars, cases
from benchmarks.harness.cases import named, run_cases, seed_range

_GROUPS = ("faults", "clean", "explained", "effects", "large_effects", "files")


def _jobs(args: argparse.Namespace) -> dict[str, cases.Task]:
    tasks = cases.tasks(seed_range(args.seeds), args.quick)
    return named(task for task in tasks if task.group in args.groups)


if __name__ == "__main__":
    code = run_cases(
        __doc__,
        "check",
        "166402:166402",
        _GROUPS,
        ["benchmarks/check_parts", "flows/inputs", "flows/steps"],
        _jobs,
        cases.run,
        cases.summary,
        lambda rows, args: bars.figures(rows, args.whole),
    )
    sys.exit(code)
