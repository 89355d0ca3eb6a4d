"""Options, finished cases and crashes of benchmarks over drawn cases.

A process pool runs the cases; each gives one row. Finished rows are kept line by line,
so that an interrupted run continues where it stopped.
"""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from benchmarks.harness.figures import CRASHES, Figures, figure, one_blas_thread
from benchmarks.harness.origin import ROOT, STORE, circumstances, code_hash, save
from flows.workers import ProcessExecutor, run_jobs

Rows = Sequence[Mapping]
QUICK_SEEDS = "1:1"
_DRAWS = ("benchmarks/hidden", "benchmarks/synthetic")


def read_options(about: str, seeds: str, groups: Sequence[str]) -> argparse.Namespace:
    """Read the command line of a benchmark over drawn cases.

    `deciding`: whether seeds and counts are those that the bars are for; `whole`:
    whether all groups run with these. A quick run has its own seeds.
    """
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a part, under 50 s")
    parser.add_argument("--seeds", default=seeds, metavar="A:B", help="both included")
    parser.add_argument("--groups", nargs="*", default=list(groups), choices=groups)
    parser.add_argument("--processes", type=int, default=2, metavar="N")
    parser.add_argument("--full-json", type=Path, metavar="FILE")
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
    """Return the row of a case; of a crash a row with its error."""
    try:
        return work()
    except Exception as error:
        return {**about, "error": f"{type(error).__name__}: {error}"}


def group_figures(
    rows: Mapping[str, Rows], makers: Mapping[str, Callable[[Rows], Figures]]
) -> Figures:
    figures: Figures = {}
    for group, make in makers.items():
        if group in rows:
            figures |= make([r for r in rows[group] if "outcome" in r])
    return figures


def crash_figures(rows: Mapping[str, Rows]) -> Figures:
    every = [row for group in rows.values() for row in group]
    count = sum("error" in row for row in every)
    return {CRASHES: figure(count, 0, len(every))}


def kept_file(name: str, *parts: str) -> Path:
    """Return the file of finished rows of the present code.

    The code is the product, what draws cases, and `parts`, except `bars.py` files,
    which only make figures from rows.
    """
    plan = [
        file.relative_to(ROOT).as_posix()
        for path in (ROOT / part for part in parts)
        for file in (sorted(path.rglob("*.py")) if path.is_dir() else [path])
        if file.name != "bars.py"
    ]
    product = code_hash("residual", "sim", "warehouse/logs", *_DRAWS)
    return STORE / f"{name}-{product}-{code_hash(*plan)[:10]}.jsonl"


def run_kept(
    path: Path,
    summary: Callable[[Mapping], str],
    work: Callable[[Any], dict],
    jobs: Mapping[str, Any],
    pool: Executor | None = None,
    processes: int = 2,
) -> dict[str, dict]:
    """Run the jobs that are not finished and return the results of all by name.

    The file has a line for each finished case; `summary` makes the line to print. The
    default pool has so many processes with one BLAS thread each.
    """
    one_blas_thread()
    path.parent.mkdir(parents=True, exist_ok=True)
    known = _read_kept(path)
    todo = [name for name in jobs if name not in known]
    if len(todo) < len(jobs):
        print(f"{len(jobs) - len(todo)} of {len(jobs)} finished before", flush=True)
    with (
        pool or ProcessExecutor(processes) as pool,
        path.open("a", encoding="utf-8") as file,
    ):
        # An interruption may have cut off the last line.
        file.write("\n" if path.stat().st_size else "")
        done = run_jobs(pool, work, [jobs[name] for name in todo])
        for count, job in enumerate(done, start=1):
            name, value = todo[job.index], job.value
            if job.error is not None:
                value = {"error": str(job.error)}
            known[name] = json.loads(json.dumps(value))
            if job.error is None:
                file.write(json.dumps({name: value}) + "\n")
                file.flush()
            line = f"crash: {value['error']}" if "error" in value else summary(value)
            print(f"[{count}/{len(todo)}] {name}: {line}", flush=True)
    return {name: known[name] for name in jobs}


def _read_kept(path: Path) -> dict[str, dict]:
    known: dict[str, dict] = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                known.update(json.loads(line))
            except ValueError:
                continue  # cut off by an interruption
    return known
