"""Figures of a benchmark: value, bar, verdict; their groups, table and last line.

Loads no NumPy, so that a run may still choose its threads.
"""

import argparse
import json
import os
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from time import perf_counter

from benchmarks.harness.origin import circumstances, is_current, save

Figures = dict[str, dict]

NO_BAR = "for information, no bar of its own"
FEW = "not the deciding draws; the full run decides"
NO_LOGS = "no measured logs: neither ../shared/data nor $MODELGAP_DATA"
CRASHES = "crashes"


def one_blas_thread() -> None:
    """Give every process started from here on one BLAS thread."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"


def figure(value: float | None, bar: float | None, n: int, **extra: object) -> dict:
    """Return a figure of n cases that must not exceed its bar, if it has one.

    Anything else is recorded too: `ok` overrides the comparison, and a `why` explains
    an `ok` of None.
    """
    ok = None if value is None or bar is None else bool(value <= bar)
    return {"value": value, "bar": bar, "ok": ok, "n": n, **extra}


def missing(bar: float | None, why: str) -> dict:
    """Return a figure that this run cannot measure."""
    return figure(None, bar, 0, why=why)


def partial(entry: dict, why: str) -> dict:
    """Return the figure of a run that is too small to confirm it, only to refute."""
    return {**entry, "ok": False if entry["ok"] is False else None, "why": why}


def all_missing(bars: Mapping[str, float | None], why: str) -> Figures:
    """Return figures that this run cannot measure, from their bars."""
    return {name: missing(bar, why) for name, bar in bars.items()}


def all_partial(figures: Figures, why: str) -> Figures:
    """Return figures of a run that is too small to confirm any; "" where it is not."""
    return {k: partial(f, why) for k, f in figures.items()} if why else figures


def undecided(figures: Figures) -> Figures:
    """Return figures that no bar is for, crashes apart."""
    return {
        name: entry | {"ok": None, "why": entry.get("why") or FEW}
        if entry["bar"] is not None and name != CRASHES
        else entry
        for name, entry in figures.items()
    }


def show(figures: Figures) -> None:
    width = max(len(name) for name in figures)
    print(f"\n{'figure':{width}}  {'value':>9}  {'bar':>7}  {'n':>4}  result")
    for name, entry in figures.items():
        value, bar = (_number(entry[key]) for key in ("value", "bar"))
        result = {True: "ok", False: "MISSED", None: "-"}[entry["ok"]]
        why = f"  ({entry['why']})" if entry.get("why") else ""
        print(f"{name:{width}}  {value:>9}  {bar:>7}  {entry['n']:>4}  {result}{why}")


def finish(figures: Figures) -> int:
    """Print the table and the last line; return 1 if a bar is missed, else 0."""
    show(figures)
    print(json.dumps(figures), flush=True)
    return int(any(entry["ok"] is False for entry in figures.values()))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


_OF_A_RUN = ("commit", "dirty", "code", "date", "cores", "quick")


def run_groups(
    about: str,
    groups: Mapping[str, str],
    measure: Callable[[str, bool], Figures] | None = None,
    own: argparse.ArgumentParser | None = None,
    **facts: object,
) -> int:
    """Measure the groups that were asked for and return the exit code.

    Args:
        groups: Of each group, in order, the function that measures it, as
            "module:function" below benchmarks; it takes whether to be quick.
        measure: In place of calling that function, from the name of a group and
            whether to be quick to its figures.
        own: Options of this benchmark alone (made with `add_help=False`), for `--help`.
    """
    args = _arguments(about, list(groups), own)
    # Before NumPy is loaded, here and in what this starts.
    one_blas_thread()
    name, made = (args.full_json.stem if args.full_json else ""), {}
    earlier = _read(args.full_json)
    about_run = circumstances(name, quick=args.quick, **facts)
    for group in args.groups:
        run = earlier.get("by_group", {}).get(group, {})
        if args.resume and is_current(name, run):
            print(f"{group}: known", flush=True)
            continue
        start = perf_counter()
        work = measure or (lambda name, quick: function_of(groups[name])(quick))
        made[group] = work(group, args.quick)
        print(f"{group}: {perf_counter() - start:.1f} s", flush=True)
        if args.full_json:  # after each: what is measured is not lost with the rest
            earlier = merged(earlier, {group: made[group]}, about_run, list(groups))
            save(args.full_json, earlier)
    fresh = {name: entry for own in made.values() for name, entry in own.items()}
    return finish(earlier["figures"] if args.resume else fresh)


def _read(path: Path | None) -> dict:
    if path is None or not path.exists():
        return {}
    return json.loads(path.read_text(encoding="utf-8"))


def function_of(place: str) -> Callable[..., Figures]:
    """Return a function from "module:function"; only now its NumPy is loaded."""
    module, _, name = place.partition(":")
    return getattr(import_module(f"benchmarks.{module}"), name)


def merged(
    earlier: Mapping, made: Mapping[str, Figures], about: Mapping, groups: Sequence[str]
) -> dict:
    """Return a results file with the groups of this run in place of their old ones.

    It has the figures of all groups, in order, and of each from which run they are
    (`by_group`). The other facts are those of this run.
    """
    kept = {
        name: (run, {key: earlier["figures"][key] for key in run["figures"]})
        for name, run in earlier.get("by_group", {}).items()
        if name not in made
    }
    run = {key: about[key] for key in _OF_A_RUN}
    fresh = {name: ({**run, "figures": list(own)}, own) for name, own in made.items()}
    every = kept | fresh
    order = [name for name in groups if name in every]
    figures = {key: f for name in order for key, f in every[name][1].items()}
    runs = {name: every[name][0] for name in order}
    whole = order == list(groups)
    return {**about, "whole": whole, "by_group": runs, "figures": figures}


def _arguments(
    about: str, groups: Sequence[str], own: argparse.ArgumentParser | None
) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=about,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        parents=[own] if own else [],
    )
    parser.add_argument("--quick", action="store_true", help="a part, under 50 s")
    parser.add_argument("--groups", nargs="+", choices=groups, default=groups)
    text = "results file; what it has of other groups stays"
    parser.add_argument("--full-json", type=Path, metavar="OUT", help=text)
    text = "measure only the groups that OUT does not have of this very code"
    parser.add_argument("--resume", action="store_true", help=text)
    args = parser.parse_args()
    if args.resume and not args.full_json:
        parser.error("--resume needs --full-json: the file that has what is known")
    return args
