"""Nominal-level PLSR: its speed, its errors on simulated and on measured arms.

    python benchmarks/plsr.py --quick                     under 50 s on two cores
    python benchmarks/plsr.py --full-json benchmarks/results/plsr.json

Peers run in the same process with one BLAS thread and are timed in processor time. The
last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

GROUPS = {
    "fit": "plsr_parts.speed:fit_figures",
    "errors": "plsr_parts.errors:paper_set_figures",
    "measured": "plsr_parts.errors:measured_figures",
}

if __name__ == "__main__":
    sys.exit(run_groups(__doc__, "plsr", GROUPS))
