"""What benchmarks over drawn cases share: their options, and figures of their rows."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from benchmarks.figures import Figures, circumstances, figure, save

Rows = Sequence[Mapping]

FEW = "not the deciding draws; the full run decides"
CRASHES = "crashes"


def seeded_options(
    about: str, seeds: str, groups: Sequence[str], quick: str = "a part, under 50 s"
) -> argparse.ArgumentParser:
    """Return the options that all of them have.

    Args:
        seeds: The seeds that decide, as A:B.
    """
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--seeds", default=seeds, metavar="A:B", help="both included")
    parser.add_argument("--groups", nargs="*", default=list(groups), choices=groups)
    parser.add_argument("--full-json", type=Path, metavar="FILE")
    text = "where finished cases are kept instead"
    parser.add_argument("--keep", type=Path, metavar="FILE.jsonl", help=text)
    return parser


def read_options(
    parser: argparse.ArgumentParser, quick_seeds: str
) -> argparse.Namespace:
    """Read the command line; a quick run has seeds of its own."""
    args = parser.parse_args()
    if args.quick:
        args.seeds = quick_seeds
    return args


def seed_range(seeds: str) -> range:
    """Return the seeds of A:B, both included."""
    first, last = (int(word) for word in seeds.split(":"))
    return range(first, last + 1)


def range_text(seeds: range) -> str:
    """Return seeds as A:B, both included."""
    return f"{seeds[0]}:{seeds[-1]}"


def save_rows(args: argparse.Namespace, figures: Figures, **rows: object) -> None:
    """Write figures and rows to the results file, if one is asked for."""
    if args.full_json:
        facts = circumstances(seeds=args.seeds, quick=args.quick, groups=args.groups)
        save(args.full_json, {**facts, "figures": figures, **rows})


def guarded(about: Mapping, work: Callable[[], dict]) -> dict:
    """Return the row of a case, or of its crash, which is a result like any other.

    Args:
        about: What the row of a crash says of its case.
    """
    try:
        return work()
    except Exception as error:
        # A benchmark of thousands of cases reports a crash and goes on.
        return {**about, "error": f"{type(error).__name__}: {error}"}


def group_figures(
    rows: Mapping[str, Rows], makers: Mapping[str, Callable[[Rows], Figures]]
) -> Figures:
    """Return the figures of every group that was run, from finished cases."""
    figures: Figures = {}
    for group, make in makers.items():
        if group in rows:
            figures |= make([r for r in rows[group] if "outcome" in r])
    return figures


def crash_figures(rows: Mapping[str, Rows]) -> Figures:
    """Return how many cases did not come to their end."""
    every = [row for group in rows.values() for row in group]
    count = sum("error" in row for row in every)
    return {CRASHES: figure(count, 0, len(every))}


def undecided(figures: Figures) -> Figures:
    """Return figures that no bar is for, crashes apart."""
    return {
        name: entry | {"ok": None, "why": entry.get("why") or FEW}
        if entry["bar"] is not None and name != CRASHES
        else entry
        for name, entry in figures.items()
    }
