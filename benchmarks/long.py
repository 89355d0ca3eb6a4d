"""What does a log of an hour at 1 kHz cost, and does it say what it says in memory?

    python benchmarks/long.py --quick
    python benchmarks/long.py --full-json benchmarks/results/long.json

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

GROUPS = {
    "cost": "long_parts.commands:cost_figures",
    "same": "long_parts.commands:same_figures",
}


if __name__ == "__main__":
    sys.exit(run_groups(__doc__, GROUPS))
