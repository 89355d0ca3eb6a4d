"""What do schedules and flows cost, and does a cluster give the same bits?

    python benchmarks/pipelines.py --quick                     under 50 s on two cores
    python benchmarks/pipelines.py --full-json benchmarks/results/pipelines.json

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import run_groups

GROUPS = {
    "service": "pipelines_parts.service:service_figures",
    "efficiency": "pipelines_parts.service:efficiency_figures",
    "dask": "pipelines_parts.service:cluster_figures",
}


if __name__ == "__main__":
    sys.exit(run_groups(__doc__, GROUPS))
