"""Many robots, many logs, one program: a project of one's own, an inbox, a store.

    python benchmarks/fleet.py --quick                  under 50 s on two cores
    python benchmarks/fleet.py --groups first
    python benchmarks/fleet.py --full-json OUT              benchmarks/results/...

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from importlib import import_module
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import Figures
from benchmarks.groups import run_groups

# Each a module of benchmarks/fleet_parts with a function `figures_of`.
_GROUPS = ("first", "inbox", "objects")


def main() -> int:
    """Run the groups and return the exit code."""
    return run_groups(__doc__, _GROUPS, _measure)


def _measure(name: str, quick: bool) -> Figures:
    return import_module(f"benchmarks.fleet_parts.{name}").figures_of(quick)


if __name__ == "__main__":
    sys.exit(main())
