"""Many robots, many logs, one program: a project of one's own, an inbox, a store.

    python benchmarks/fleet.py --quick                  under 50 s on two cores
    python benchmarks/fleet.py --groups first
    python benchmarks/fleet.py --full-json OUT              benchmarks/results/...

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

GROUPS = {
    "first": "fleet_parts.inbox:first_figures",
    "inbox": "fleet_parts.inbox:inbox_figures",
    "objects": "fleet_parts.objects:object_figures",
}


if __name__ == "__main__":
    sys.exit(run_groups(__doc__, GROUPS))
