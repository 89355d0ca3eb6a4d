"""Is the store quick, small, safe among writers, and whole after any kill?

    python benchmarks/store.py --quick                     under 50 s on two cores
    python benchmarks/store.py --full-json benchmarks/results/store.json

The last line is one JSON object; exit code 1 for a missed bar. Bars of time need an
idle machine: where its load was above 1 before, a missed one is null and says so.
"""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.figures import Figures, function_of, run_groups

GROUPS = {
    "commit": "store_parts.timed:commit_figures",
    "many": "store_parts.timed:many_figures",
    "together": "store_parts.timed:together_figures",
    "kills": "store_parts.kills:kill_figures",
}
_TIMED = ("commit", "many")
BUSY = 1.0


def main() -> int:
    load = os.getloadavg()[0]

    def measure(name: str, quick: bool) -> Figures:
        figures = function_of(GROUPS[name])(quick)
        return judged(figures, load) if name in _TIMED else figures

    return run_groups(__doc__, GROUPS, measure, load_before=load)


def judged(figures: Figures, load: float) -> Figures:
    """Return figures of which a busy machine can miss no bar of time."""
    if load <= BUSY:
        return figures
    why = f"the load was {load:.1f} before; the bar is of an idle machine"
    return {
        name: {**entry, "ok": None, "why": why}
        if entry["ok"] is False and not name.startswith("size")
        else entry
        for name, entry in figures.items()
    }


if __name__ == "__main__":
    sys.exit(main())
