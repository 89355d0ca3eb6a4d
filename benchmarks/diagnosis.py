"""Is the right effect named, at its joint, and nothing where nothing is?

    python benchmarks/diagnosis.py --quick                     under 50 s on two cores
    python benchmarks/diagnosis.py --seeds 1:2 --groups singles      to look at
    python benchmarks/diagnosis.py --full-json benchmarks/results/diagnosis.json

Seeds 5001:5010 decide and are used for nothing else; 1 to 99 are for development. Sizes
are in minimum detectable ones, as the diagnosis says them of an arm with nothing hidden
in the same motions. Finished cases are kept in store/benchmarks, by a hash of the code:
an interrupted run goes on where it was. The last line is one JSON object; exit code 1
for a missed bar.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.diagnosis_parts import bars, cases, kept, measured
from benchmarks.figures import (
    Figures,
    figure,
    finish,
    missing,
    one_blas_thread,
)
from benchmarks.measured_parts import shell
from benchmarks.seeded import read_options, save_rows, seed_range, seeded_options
from flows.workers.pool import Pool

_SEEDS, _QUICK_SEEDS = "5001:5010", "1:1"
_CASES = ("singles", "nulls", "unknown", "pairs", "forms", "detection")
_GROUPS = (*_CASES, "cost", "measured")
_SECONDS, _GIGABYTES = 10.0, 1.0


def main() -> int:
    """Run the groups and return the exit code."""
    args = read_options(seeded_options(__doc__, _SEEDS, _GROUPS), _QUICK_SEEDS)
    figures: Figures = {}
    if "cost" in args.groups:
        figures |= _cost(args.quick)
    # For the pool: its processes load NumPy after this.
    one_blas_thread()
    wanted = [g for g in _CASES if g in args.groups]
    with kept.Kept(args.keep) as known, Pool(2) as pool:
        rows = _run_cases(args, wanted, known, pool)
        results = _run_measured(args, known, pool)
    if wanted:
        deciding = args.seeds == _SEEDS and not args.quick
        figures |= bars.case_figures(rows, deciding)
    if "measured" in args.groups:
        figures |= measured.measured_figures(results)
    save_rows(args, figures, cases=rows, measured=results)
    return finish(figures)


def _run_cases(args: argparse.Namespace, groups, known, pool) -> Mapping[str, list]:
    """Run the cases of all groups, those that say sizes first."""
    seeds = seed_range(args.seeds)
    wanted = {group: cases.tasks(group, seeds, args.quick) for group in groups}
    every = [task for tasks in wanted.values() for task in tasks]
    sizes = {}
    benches = cases.benches(every)
    for task, row in _done(known, pool, [(b, ()) for b in benches]):
        if "error" in row:
            raise SystemExit(f"{task.name} failed: no sizes known. {row['error']}")
        sizes[task.data, task.motion] = row["minimum"]
    jobs = [(task, sizes.get((task.data, task.motion), ())) for task in every]
    rows = {task.name: row for task, row in _done(known, pool, jobs)}
    return {group: [rows[t.name] for t in tasks] for group, tasks in wanted.items()}


def _done(known, pool, jobs: list) -> Iterator[tuple]:
    done = known.run(pool, cases.run, {job[0].name: job for job in jobs})
    yield from ((job[0], done[job[0].name]) for job in jobs)


def _run_measured(args: argparse.Namespace, known, pool) -> list[dict]:
    jobs = measured.jobs(args.quick) if "measured" in args.groups else []
    named = {f"measured {' '.join(job)}": job for job in jobs}
    done = known.run(pool, measured.run, named)
    return [done[name] for name in named]


def _cost(quick: bool) -> Figures:
    """Time and memory of one diagnosis of two minutes of data, from the shell."""
    if quick:
        why = "the full run decides"
        names = {"seconds": _SECONDS, "peak_gb": _GIGABYTES}
        return {name: missing(bar, why) for name, bar in names.items()}
    done = shell.shell_figures(3)
    out = {}
    for name, bar in (("seconds", _SECONDS), ("peak_gb", _GIGABYTES)):
        entry = done[f"shell_{name}"]
        extra = {k: entry[k] for k in ("all", "why") if k in entry}
        out[name] = figure(entry["value"], bar, entry["n"], **extra)
        if entry["value"] is None:
            out[name] |= {"ok": False}
    return out


if __name__ == "__main__":
    sys.exit(main())
