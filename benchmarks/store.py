"""Is the store quick, small, safe among writers, and whole after any kill?

    python benchmarks/store.py --quick                     under 50 s on two cores
    python benchmarks/store.py --full-json benchmarks/results/store.json

The last line is one JSON object; exit code 1 for a missed bar. Bars of time need an
idle machine: where its load was above 1 before, a missed one is null and says so.
"""

import argparse
import os
import sys
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import (
    Figures,
    circumstances,
    finish,
    one_blas_thread,
    save,
)

_GROUPS = ("commit", "many", "together", "kills")
_TIMED = ("commit", "many")
BUSY = 1.0


def main() -> int:
    """Run the groups and return the exit code."""
    args = _arguments()
    # Before NumPy is loaded, here and in other processes.
    one_blas_thread()
    figures: Figures = {}
    load = os.getloadavg()[0]
    for name in args.groups:
        start = perf_counter()
        found = _measure(name, args.quick)
        figures |= _judged(found, load) if name in _TIMED else found
        print(f"{name}: {perf_counter() - start:.1f} s", flush=True)
    if args.full_json:
        about = circumstances(quick=args.quick, load_before=load)
        save(args.full_json, {**about, "figures": figures})
    return finish(figures)


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


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a part, under 50 s")
    parser.add_argument("--groups", nargs="+", choices=_GROUPS, default=_GROUPS)
    parser.add_argument("--full-json", type=Path, metavar="OUT", help="results file")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
