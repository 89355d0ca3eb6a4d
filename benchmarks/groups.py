"""The command line that benchmarks of several groups share."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter

from benchmarks.figures import (
    Figures,
    circumstances,
    finish,
    one_blas_thread,
    save,
)


def run_groups(
    about: str,
    groups: Sequence[str],
    measure: Callable[[str, bool], Figures],
    **facts: object,
) -> int:
    """Measure the groups that were asked for and return the exit code.

    Args:
        about: What `--help` says.
        groups: Names of the groups, in order.
        measure: From the name of a group, and whether to be quick, to its figures; it
            imports what it needs itself, since NumPy must not be loaded before.
        facts: What else to keep of the circumstances.
    """
    args = _arguments(about, groups)
    # Before NumPy is loaded, here and in what this starts.
    one_blas_thread()
    figures: Figures = {}
    for name in args.groups:
        start = perf_counter()
        figures |= measure(name, args.quick)
        print(f"{name}: {perf_counter() - start:.1f} s", flush=True)
    if args.full_json:
        about_run = circumstances(quick=args.quick, **facts)
        save(args.full_json, {**about_run, "figures": figures})
    return finish(figures)


def _arguments(about: str, groups: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a part, under 50 s")
    parser.add_argument("--groups", nargs="+", choices=groups, default=groups)
    parser.add_argument("--full-json", type=Path, metavar="OUT", help="results file")
    return parser.parse_args()
