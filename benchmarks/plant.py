"""Is the plant exact, sound in its books, fast, stable, always the same; well excited?

    python benchmarks/plant.py --quick                     under 50 s on two cores
    python benchmarks/plant.py --full-json benchmarks/results/plant.json

The last line is one JSON object; exit code 1 for a missed bar.
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

_GROUPS = ("identity", "energy", "stability", "determinism", "speed", "excitation")


def main() -> int:
    """Run the groups and return the exit code."""
    args = _arguments()
    # Before NumPy is loaded, here and in the pool.
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
    from benchmarks.plant_parts import excitation, identity, physics, speed

    if name == "identity":
        return identity.identity_figures(1 if quick else 5, quick)
    if name == "energy":
        families, seeds = (1, 1) if quick else (3, 3)
        return physics.energy_figures(families, seeds)
    if name == "stability":
        return physics.stability_figures(3.0 if quick else 10.0, quick)
    if name == "determinism":
        return physics.determinism_figures(3 if quick else 18)
    if name == "speed":
        return speed.speed_figures(3 if quick else 11)
    return excitation.excitation_figures(quick)


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
