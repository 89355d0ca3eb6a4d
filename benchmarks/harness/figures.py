"""Figures of a benchmark: value, bar, verdict; their groups, table and last line.

Loads no NumPy, so that a run may still choose its threads.
"""

import argparse
import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).resolve().parents[2]

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
    """Return a figure that must not exceed its bar.

    Args:
        value: What was measured, None if it was not.
        bar: What it may be at most, None where there is no bar.
        extra: Anything else to record; `ok` overrides the comparison, and a `why`
            explains an `ok` of None.
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
    """Print the table of figures."""
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


def code_hash(*own: str) -> str:
    """Return a hash over the code and the robots that decide results.

    Args:
        own: Folders of the benchmark; none for those of measured arms.
    """
    digest = hashlib.sha256()
    own = own or ("benchmarks/measured_parts",)
    for folder in ("residual", "sim", "warehouse/logs", *own):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".urdf", ".toml"):
                digest.update(str(path.relative_to(ROOT)).encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def circumstances(**extra: object) -> dict:
    """Return commit, code hash, date and machine of this run."""
    return {
        "commit": _git("rev-parse", "HEAD"),
        "dirty": bool(_git("status", "--porcelain")),
        "code_hash": code_hash(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        **extra,
    }


def save(path: Path, content: dict) -> None:
    """Write a result file, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".part")
    draft.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    draft.replace(path)


def _git(*words: str) -> str | None:
    done = subprocess.run(
        ["git", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() if done.returncode == 0 else None


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


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
