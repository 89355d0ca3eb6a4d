"""What do schedules and flows cost, and does a cluster give the same bits?

    python benchmarks/pipelines.py --quick                     under 50 s on two cores
    python benchmarks/pipelines.py --full-json benchmarks/results/pipelines.json

The last line is one JSON object; exit code 1 for a missed bar.
"""

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import (
    Figures,
    circumstances,
    finish,
    one_blas_thread,
    save,
)

_GROUPS = ("service", "efficiency", "dask")


def main() -> int:
    """Run the groups and return the exit code."""
    args = _arguments()
    # Before NumPy is loaded, here and in the pool.
    one_blas_thread()
    figures: Figures = {}
    for name in args.groups:
        start = perf_counter()
        with TemporaryDirectory(prefix="modelgap-") as folder:
            figures |= _measure(name, args.quick, Path(folder))
        print(f"{name}: {perf_counter() - start:.1f} s", flush=True)
    if args.full_json:
        save(args.full_json, {**circumstances(quick=args.quick), "figures": figures})
    return finish(figures)


def _measure(name: str, quick: bool, folder: Path) -> Figures:
    from benchmarks.pipelines_parts import cluster, efficiency, service

    if name == "service":
        return service.service_figures(folder, quick)
    if name == "efficiency":
        return efficiency.efficiency_figures(folder, quick)
    return cluster.cluster_figures(folder, quick)


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
