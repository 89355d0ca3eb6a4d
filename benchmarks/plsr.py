"""Is the paper's regression as fast as it should be, and does it keep what it promises?

    python benchmarks/plsr.py --quick                     under 50 s on two cores
    python benchmarks/plsr.py --full-json benchmarks/results/plsr.json

Peers are measured in the same run, with one BLAS thread each, in processor time. The
last line is one JSON object; exit code 1 for a missed bar.
"""

import argparse
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

_GROUPS = ("fit", "sweep", "lookup", "errors", "monitoring")


def main() -> int:
    """Run the groups and return the exit code."""
    args = _arguments()
    # Before NumPy is loaded, here and in what this starts.
    one_blas_thread()
    figures: Figures = {}
    for name in args.groups:
        start = perf_counter()
        figures |= _measure(name, args.quick)
        print(f"{name}: {perf_counter() - start:.1f} s", flush=True)
    if args.full_json:
        save(args.full_json, {**circumstances(quick=args.quick), "figures": figures})
    return finish(figures)


def _measure(name: str, quick: bool) -> Figures:
    from benchmarks.plsr_parts import fit, monitoring, paper_set, sweep, tables

    if name == "fit":
        return fit.fit_figures(quick)
    if name == "sweep":
        return sweep.sweep_figures(quick)
    if name == "lookup":
        return tables.lookup_figures(3 if quick else 9)
    if name == "errors":
        return paper_set.paper_set_figures(quick)
    return monitoring.monitoring_figures(quick)


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
