"""The command line that benchmarks of several groups share."""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from time import perf_counter

from benchmarks.harness.figures import (
    Figures,
    circumstances,
    finish,
    one_blas_thread,
    save,
)

_OF_A_RUN = ("commit", "dirty", "code_hash", "date", "cores", "quick")


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
    found: dict[str, Figures] = {}
    for name in args.groups:
        start = perf_counter()
        work = measure or (lambda name, quick: function_of(groups[name])(quick))
        found[name] = work(name, args.quick)
        print(f"{name}: {perf_counter() - start:.1f} s", flush=True)
    if args.full_json:
        file = args.full_json
        earlier = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
        about_run = circumstances(quick=args.quick, **facts)
        save(file, merged(earlier, found, about_run, list(groups)))
    return finish({name: f for own in found.values() for name, f in own.items()})


def function_of(place: str) -> Callable[..., Figures]:
    """Return a function from "module:function"; only now its NumPy is loaded."""
    module, _, name = place.partition(":")
    return getattr(import_module(f"benchmarks.{module}"), name)


def merged(
    earlier: Mapping, made: Mapping[str, Figures], about: Mapping, groups: Sequence[str]
) -> dict:
    """Return a results file with the groups of this run in place of their old ones.

    Args:
        earlier: The file as it was; empty where there was none.
        groups: All groups that there are, in order.

    Returns:
        Figures of all groups, and of each from which run they are (`by_group`). The
        other facts are those of this run.
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
    return {**about, "by_group": runs, "figures": figures}


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
    return parser.parse_args()
