"""Is the paper's regression as fast as it should be, and does it keep what it promises?

    python benchmarks/plsr.py --quick                     under 50 s on two cores
    python benchmarks/plsr.py --full-json benchmarks/results/plsr.json

Peers are measured in the same run, with one BLAS thread each, in processor time. The
last line is one JSON object; exit code 1 for a missed bar.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import Figures
from benchmarks.groups import run_groups

_GROUPS = ("fit", "sweep", "lookup", "errors", "sparse", "measured", "monitoring")


def main() -> int:
    """Run the groups and return the exit code."""
    return run_groups(__doc__, _GROUPS, _measure)


def _measure(name: str, quick: bool) -> Figures:
    from benchmarks.plsr_parts import (
        fit,
        measured,
        monitoring,
        paper_set,
        sparse,
        sweep,
        tables,
    )

    if name == "fit":
        return fit.fit_figures(quick)
    if name == "sweep":
        return sweep.sweep_figures(quick)
    if name == "lookup":
        return tables.lookup_figures(3 if quick else 9)
    if name == "errors":
        return paper_set.paper_set_figures(quick)
    if name == "sparse":
        return sparse.sparse_figures(quick)
    if name == "measured":
        return measured.measured_figures(quick)
    return monitoring.monitoring_figures(quick)


if __name__ == "__main__":
    sys.exit(main())
