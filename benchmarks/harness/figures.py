"""Figures of a benchmark (value, bar, result), their table, and runs by groups.

Loads no NumPy, so that a run can still choose its number of threads.
"""

import argparse
import json
import os
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from time import perf_counter

from rich.console import Console
from rich.table import Table

from benchmarks.harness.origin import PRODUCT, STORE, circumstances, code_hash, save

Figures = dict[str, dict]

NO_BAR = "for information, no bar"
FEW = "not the deciding seeds; the full run decides"
FULL = "the full run measures it"
NO_LOGS = "no measured logs: neither ../shared/data nor $MODELGAP_DATA"
CRASHES = "crashes"
QUICK_SEEDS = "1:1"
_BEGUN = perf_counter()


def one_blas_thread() -> None:
    """Give every process started from here on one BLAS thread."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"


def figure(value: float | None, bar: float | None, n: int, **extra: object) -> dict:
    """Return a figure of n cases that must not exceed its bar, if it has one.

    Extra entries are recorded too: `ok` overrides the comparison, `why` explains an
    `ok` of None.
    """
    ok = None if value is None or bar is None else bool(value <= bar)
    return {"value": value, "bar": bar, "ok": ok, "n": n, **extra}


def missing(bar: float | None, why: str) -> dict:
    return figure(None, bar, 0, why=why)


def all_missing(bars: Mapping[str, float | None], why: str) -> Figures:
    return {name: missing(bar, why) for name, bar in bars.items()}


def undecided(figures: Figures) -> Figures:
    """Return figures without results, except the one that counts crashes."""
    return {
        name: entry | {"ok": None, "why": entry.get("why") or FEW}
        if entry["bar"] is not None and name != CRASHES
        else entry
        for name, entry in figures.items()
    }


def read_options(about: str, groups: Sequence[str], seeds: str = "") -> argparse.Namespace:
    """Read the command line of a benchmark.

    `deciding`: whether seeds and counts are those that the bars are for; `whole`:
    whether all groups run with these. A quick run has its own seeds.
    """
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a part, under 50 s")
    if seeds:
        parser.add_argument("--seeds", default=seeds, metavar="A:B", help="both included")
        parser.add_argument("--processes", type=int, default=2, metavar="N")
    parser.add_argument("--groups", nargs="*", default=list(groups), choices=groups)
    parser.add_argument("--full-json", type=Path, metavar="FILE", help="results file")
    args = parser.parse_args()
    args.deciding = not args.quick and getattr(args, "seeds", "") == seeds
    args.whole = args.deciding and args.groups == list(groups)
    if args.quick and seeds:
        args.seeds = QUICK_SEEDS
    return args


def finish(args: argparse.Namespace, figures: Figures, **rows: object) -> int:
    """Write the results file, print the table and the last line.

    Returns:
        1 if a bar is missed, else 0.
    """
    if args.full_json:
        known = ("seeds", "quick", "groups", "whole")
        facts = {key: vars(args)[key] for key in known if key in vars(args)}
        minutes = round((perf_counter() - _BEGUN) / 60, 1)  # of this process
        facts = circumstances(args.full_json.stem, **facts, minutes=minutes)
        save(args.full_json, {**facts, "figures": figures, **rows})
    table = Table("figure", box=None)
    for name in ("value", "bar", "n"):
        table.add_column(name, justify="right")
    table.add_column("result")
    for name, entry in figures.items():
        value, bar = (
            "-" if entry[key] is None else f"{entry[key]:.4g}" for key in ("value", "bar")
        )
        result = {True: "ok", False: "MISSED", None: "-"}[entry["ok"]]
        why = f" ({entry['why']})" if entry.get("why") else ""
        table.add_row(name, value, bar, str(entry["n"]), result + why)
    Console(width=120).print(table)
    print(json.dumps(figures), flush=True)
    return int(any(entry["ok"] is False for entry in figures.values()))


def run_groups(about: str, name: str, groups: Mapping[str, str]) -> int:
    """Measure the selected groups and return the exit code.

    Finished groups of a full run are kept in store/benchmarks by a hash of the code,
    so that an interrupted run continues where it stopped.

    Args:
        name: Name of the benchmark.
        groups: For each group the function that measures it, as "module:function"
            below benchmarks; it takes whether the run is quick.
    """
    args = read_options(about, list(groups))
    # Before NumPy is loaded, here and in child processes.
    one_blas_thread()
    parts = {f"benchmarks/{place.partition('.')[0]}" for place in groups.values()}
    path = STORE / f"{name}-{code_hash(*PRODUCT, *sorted(parts))}.json"
    kept = json.loads(path.read_text("utf-8")) if path.exists() else {}
    figures: Figures = {}
    for group in args.groups:
        if args.quick or group not in kept:
            start = perf_counter()
            kept[group] = function_of(groups[group])(args.quick)
            print(f"[{group}] {perf_counter() - start:.1f} s", flush=True)
            if not args.quick:
                save(path, kept)
        figures |= kept[group]
    return finish(args, undecided(figures) if args.quick else figures)


def function_of(place: str) -> Callable[..., Figures]:
    """Import a function given as "module:function", with its NumPy."""
    module, _, name = place.partition(":")
    return getattr(import_module(f"benchmarks.{module}"), name)
