"""Does hostile input, damage, a kill or a full disk get through to the store or to SQL?

    python benchmarks/hardening.py --quick                     a part of each group
    python benchmarks/hardening.py --groups flips full         two of the groups
    python benchmarks/hardening.py --full-json benchmarks/results/hardening.json

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import Figures
from benchmarks.groups import run_groups

_GROUPS = ("cost", "inputs", "flips", "kills", "full")


def main() -> int:
    """Run the groups and return the exit code."""
    return run_groups(__doc__, _GROUPS, _measure)


def _measure(name: str, quick: bool) -> Figures:
    from benchmarks.hardening_parts import cost, flips, full, inputs, kills

    if name == "cost":
        return cost.cost_figures(100 if quick else cost.FULL, 3 if quick else 15)
    if name == "inputs":
        return inputs.input_figures(8 if quick else None)
    if name == "flips":
        return flips.flip_figures(60 if quick else flips.FULL)
    if name == "kills":
        return kills.kill_figures(12 if quick else kills.FULL)
    return full.full_figures(3 if quick else full.FULL)


if __name__ == "__main__":
    sys.exit(main())
