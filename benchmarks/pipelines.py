"""What do schedules and flows cost, and does a cluster give the same bits?

    python benchmarks/pipelines.py --quick                     under 50 s on two cores
    python benchmarks/pipelines.py --full-json benchmarks/results/pipelines.json

The last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import Figures
from benchmarks.groups import run_groups

_GROUPS = ("service", "efficiency", "dask")


def main() -> int:
    """Run the groups and return the exit code."""
    return run_groups(__doc__, _GROUPS, _in_folder)


def _in_folder(name: str, quick: bool) -> Figures:
    with TemporaryDirectory(prefix="modelgap-") as folder:
        return _measure(name, quick, Path(folder))


def _measure(name: str, quick: bool, folder: Path) -> Figures:
    from benchmarks.pipelines_parts import cluster, efficiency, service

    if name == "service":
        return service.service_figures(folder, quick)
    if name == "efficiency":
        return efficiency.efficiency_figures(folder, quick)
    return cluster.cluster_figures(folder, quick)


if __name__ == "__main__":
    sys.exit(main())
