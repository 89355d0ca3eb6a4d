"""Does hostile input, damage, a kill or a full disk get through to the store or to SQL?

    python benchmarks/hardening.py --quick                     a part of each group
    python benchmarks/hardening.py --groups flips full         two of the groups
    python benchmarks/hardening.py --full-json benchmarks/results/hardening.json

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

GROUPS = {
    "cost": "hardening_parts.damage:cost_figures",
    "inputs": "hardening_parts.inputs:input_figures",
    "flips": "hardening_parts.damage:flip_figures",
    "kills": "hardening_parts.kills:kill_figures",
    "full": "hardening_parts.damage:full_figures",
}


if __name__ == "__main__":
    sys.exit(run_groups(__doc__, GROUPS))
