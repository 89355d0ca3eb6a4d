"""Speed and size of the store; its integrity is tested (tests/warehouse).

    python benchmarks/store.py --quick                     under 50 s on two cores
    python benchmarks/store.py --full-json benchmarks/results/store.json

Bars in seconds are for an idle machine: if its load was above 1 at the start, a missed
one is null.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

GROUPS = {"commit": "store_parts.speed:commit_figures", "many": "store_parts.speed:many_figures"}

if __name__ == "__main__":
    sys.exit(run_groups(__doc__, "store", GROUPS))
