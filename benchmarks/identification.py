"""Is the identification exact, honest about its errors, consistent, and fast?

    python benchmarks/identification.py --quick         under 50 s on two cores
    python benchmarks/identification.py --full-json OUT     benchmarks/results/...

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

GROUPS = {
    "identities": "identification_parts.recovery:identity_figures",
    "recovery": "identification_parts.recovery:recovery_figures",
    "measured": "identification_parts.recovery:measured_figures",
    "speed": "identification_parts.speed:speed_figures",
}


if __name__ == "__main__":
    sys.exit(run_groups(__doc__, GROUPS))
