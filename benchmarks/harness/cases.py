"""Benchmarks over drawn cases: finished rows, crashes, and the run of one benchmark.

A process pool runs the cases; each gives one row. Finished rows are kept line by line,
so that an interrupted run continues where it stopped.
"""

import json
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import astuple
from pathlib import Path
from types import ModuleType
from typing import Any

from benchmarks.harness.figures import (
    CRASHES,
    Figures,
    figure,
    finish,
    one_blas_thread,
    read_options,
)
from benchmarks.harness.origin import ROOT, STORE, code_hash
from flows.workers import ProcessExecutor, run_jobs

Rows = Sequence[Mapping]
# The product, and what draws cases.
_CODE = ("residual", "sim", "warehouse/logs", "benchmarks/hidden", "tests/synthetic")


def run_cases(
    about: str, name: str, seeds: str, parts: Sequence[str], cases: ModuleType, bars: ModuleType
) -> int:
    """Run one benchmark from its command line and return the exit code.

    Args:
        name: Of the benchmark, for its kept rows.
        seeds: Those that decide.
        parts: What draws and judges its cases: files and folders whose change makes
            kept rows worthless.
        cases: GROUPS; jobs(args), its cases by name; run(job), a row or several under
            the key "rows"; summary(row), the line to print.
        bars: all_figures(rows, args); recorded(rows), what the results file has of
            them, by default the rows by group.
    """
    args = read_options(about, cases.GROUPS, seeds)
    path = kept_file(name, *parts)
    done = run_kept(path, cases.summary, cases.run, cases.jobs(args), processes=args.processes)
    rows = [row for result in done.values() for row in result.get("rows", [result])]
    recorded = getattr(bars, "recorded", lambda rows: {"cases": by_group(rows)})
    return finish(args, bars.all_figures(rows, args), **recorded(rows))


def named(tasks: Iterable[Any]) -> dict[str, Any]:
    """Return cases, which are records, by their fields in words."""
    return {" ".join(str(x) for x in astuple(t) if x not in ("", None)): t for t in tasks}


def by_group(rows: Iterable[Mapping]) -> defaultdict[str, list[Mapping]]:
    """Return rows by their group, none for a group without rows."""
    out: defaultdict[str, list[Mapping]] = defaultdict(list)
    for row in rows:
        out[row.get("group", "")].append(row)
    return out


def seed_range(seeds: str) -> range:
    first, last = (int(word) for word in seeds.split(":"))
    return range(first, last + 1)


def guarded(about: Mapping, work: Callable[[], dict]) -> dict:
    """Return the row of a case; of a crash a row with its error."""
    try:
        return work()
    except Exception as error:
        return {**about, "error": f"{type(error).__name__}: {error}"}


def crash_figures(rows: Rows) -> Figures:
    return {CRASHES: figure(sum("error" in row for row in rows), 0, len(rows))}


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
    return STORE / f"{name}-{code_hash(*_CODE)[:8]}-{code_hash(*plan)[:8]}.jsonl"


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
    with pool or ProcessExecutor(processes) as pool, path.open("a", encoding="utf-8") as file:
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
