"""Is the identification exact, honest about its errors, consistent, and fast?

    python benchmarks/identification.py --quick         under 50 s on two cores
    python benchmarks/identification.py --full-json OUT     benchmarks/results/...

The last line is one JSON object; exit code 1 for a missed bar.
"""

import argparse
import sys
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import Figures, circumstances, finish, one_blas_thread, save

_GROUPS = ("identities", "recovery", "measured", "speed")


def main() -> int:
    """Run the groups and return the exit code."""
    args = _arguments()
    # Before NumPy is loaded.
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
    from benchmarks.identification_parts import identities, measured, recovery, speed

    if name == "identities":
        return identities.identity_figures()
    if name == "recovery":
        return recovery.recovery_figures(2 if quick else 20)
    if name == "measured":
        return measured.measured_figures(quick)
    return speed.speed_figures(2 if quick else 9)


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
