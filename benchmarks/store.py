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

from benchmarks.figures import Figures
from benchmarks.groups import run_groups

_GROUPS = ("commit", "many", "together", "kills")
_TIMED = ("commit", "many")
BUSY = 1.0


def main() -> int:
    """Run the groups and return the exit code."""
    load = os.getloadavg()[0]

    def measure(name: str, quick: bool) -> Figures:
        found = _measure(name, quick)
        return _judged(found, load) if name in _TIMED else found

    return run_groups(__doc__, _GROUPS, measure, load_before=load)


def _measure(name: str, quick: bool) -> Figures:
    from benchmarks.store_parts import commits, kills, many, together

    if name == "commit":
        return commits.commit_figures(15 if quick else 60, simulated=not quick)
    if name == "many":
        return many.many_figures(600 if quick else many.FULL, 5 if quick else 15)
    if name == "together":
        return together.together_figures(10.0 if quick else together.FULL)
    return kills.kill_figures(8 if quick else kills.FULL)


def _judged(figures: Figures, load: float) -> Figures:
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
