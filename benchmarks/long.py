"""What does a log of an hour at 1 kHz cost, and does it say what it says in memory?

    python benchmarks/long.py --quick
    python benchmarks/long.py --full-json benchmarks/results/long.json

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import Figures
from benchmarks.groups import run_groups

_GROUPS = ("cost", "same")


def main() -> int:
    """Run the groups and return the exit code."""
    return run_groups(__doc__, _GROUPS, _measure)


def _measure(name: str, quick: bool) -> Figures:
    from benchmarks.long_parts import commands

    if name == "cost":
        return commands.cost_figures(120.0 if quick else commands.HOUR)
    return commands.same_figures(120.0 if quick else commands.WHOLE)


if __name__ == "__main__":
    sys.exit(main())
