"""Is the paper's regression as fast as it should be, and does it keep what it promises?

    python benchmarks/plsr.py --quick                     under 50 s on two cores
    python benchmarks/plsr.py --full-json benchmarks/results/plsr.json

Peers are measured in the same run, with one BLAS thread each, in processor time. The
last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

GROUPS = {
    "fit": "plsr_parts.speed:fit_figures",
    "sweep": "plsr_parts.speed:sweep_figures",
    "lookup": "plsr_parts.speed:lookup_figures",
    "errors": "plsr_parts.errors:paper_set_figures",
    "measured": "plsr_parts.errors:measured_figures",
    "monitoring": "plsr_parts.monitoring:monitoring_figures",
}


if __name__ == "__main__":
    sys.exit(run_groups(__doc__, GROUPS))
