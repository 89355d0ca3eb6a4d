"""What benchmarks over drawn cases share: options, finished cases, rows and crashes.

Cases are listed before the run; each is one guarded row, done by a pool and kept line
by line, so that an interrupted run goes on where it was.
"""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from benchmarks.harness.figures import CRASHES, Figures, figure
from benchmarks.harness.origin import ROOT, circumstances, code_hash, save
from flows.workers.processes import spread

Rows = Sequence[Mapping]
STORE = ROOT / "store" / "benchmarks"
QUICK_SEEDS = "1:1"
_DRAWS = ("benchmarks/hidden", "benchmarks/synthetic")


def read_options(
    about: str,
    seeds: str,
    groups: Sequence[str],
    quick: str = "a part, under 50 s",
    **flags: str,
) -> argparse.Namespace:
    """Read the command line of a benchmark over drawn cases; `flags` are further ones.

    Of the options `deciding` says whether seeds and counts are those that bars are for,
    and `whole` whether all groups are run with these. A quick run has its own seeds.
    """
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--seeds", default=seeds, metavar="A:B", help="both included")
    parser.add_argument("--groups", nargs="*", default=list(groups), choices=groups)
    parser.add_argument("--full-json", type=Path, metavar="FILE")
    for name, text in flags.items():
        parser.add_argument(f"--{name}", action="store_true", help=text)
    args = parser.parse_args()
    args.deciding = args.seeds == seeds and not args.quick
    args.whole = args.deciding and args.groups == list(groups)
    if args.quick:
        args.seeds = QUICK_SEEDS
    return args


def seed_range(seeds: str) -> range:
    first, last = (int(word) for word in seeds.split(":"))
    return range(first, last + 1)


def save_rows(args: argparse.Namespace, figures: Figures, **rows: object) -> None:
    """Write figures and rows to the results file, if one is asked for."""
    if args.full_json:
        facts = circumstances(
            args.full_json.stem,
            seeds=args.seeds,
            quick=args.quick,
            groups=args.groups,
            whole=args.whole,
        )
        save(args.full_json, {**facts, "figures": figures, **rows})


def guarded(about: Mapping, work: Callable[[], dict]) -> dict:
    """Return the row of a case, or of its crash, which is a result like any other."""
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
    every = [row for group in rows.values() for row in group]
    count = sum("error" in row for row in every)
    return {CRASHES: figure(count, 0, len(every))}


def kept_file(name: str, *parts: str, code: str | None = None) -> Path:
    """Return where rows are kept that are made by this very code.

    `parts` run and judge besides the product and what hides and finds (or `code`, in
    place of the hash of those); what only makes figures of rows (`bars.py`) does not
    count.
    """
    plan = [
        file.relative_to(ROOT).as_posix()
        for path in (ROOT / part for part in parts)
        for file in (sorted(path.rglob("*.py")) if path.is_dir() else [path])
        if file.name != "bars.py"
    ]
    product = code or code_hash("residual", "sim", "warehouse/logs", *_DRAWS)
    return STORE / f"{name}-{product}-{code_hash(*plan)[:10]}.jsonl"


def run_kept(
    path: Path,
    words: Callable[[Mapping], str],
    pool: Executor,
    work: Callable[[Any], dict],
    jobs: Mapping[str, Any],
) -> dict[str, dict]:
    """Do what is not finished yet, and return the results of all jobs, by name.

    The file has a line for each finished case; `words` say what is printed of a row.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    known = _read_kept(path)
    todo = [name for name in jobs if name not in known]
    if len(todo) < len(jobs):
        print(f"{len(jobs) - len(todo)} of {len(jobs)} known already", flush=True)
    with path.open("a", encoding="utf-8") as file:
        # A line of its own for what comes now, whatever the last one looks like.
        file.write("\n" if path.stat().st_size else "")
        done = spread(pool, work, [jobs[name] for name in todo])
        for count, one in enumerate(done, start=1):
            name, value = todo[one.index], one.value
            if one.error is not None:
                value = {"error": str(one.error)}
            known[name] = json.loads(json.dumps(value))
            # A process that died may live another day: only results are kept.
            if one.error is None:
                file.write(json.dumps({name: value}) + "\n")
                file.flush()
            said = f"crash: {value['error']}" if "error" in value else words(value)
            print(f"[{count}/{len(todo)}] {name}: {said}", flush=True)
    return {name: known[name] for name in jobs}


def _read_kept(path: Path) -> dict[str, dict]:
    known: dict[str, dict] = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                known.update(json.loads(line))
            except ValueError:
                continue  # the line that an interruption cut off
    return known
