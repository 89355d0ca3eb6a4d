"""On arms that are never clean: is the change found, and only the change?

    python benchmarks/dirty.py --quick                          a handful of short logs
    python benchmarks/dirty.py --seeds 1:1 --groups unchanged        to look at
    python benchmarks/dirty.py --full-json benchmarks/results/dirty.json

Every joint of an arm has a background that nobody declared (`sim.background`). Seeds
8001:8010 decide and are used for nothing else; 1 to 99 are for development. Sizes are
in detectable ones, as the diagnosis says them of the same arm, unchanged. Finished
cases are kept in store/benchmarks, by a hash of the code: an interrupted run goes on
where it was. The last line is one JSON object; exit code 1 for a missed bar.
"""

import argparse
import hashlib
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.diagnosis_parts.kept import Kept
from benchmarks.dirty_parts import bars, cases, measured
from benchmarks.figures import (
    ROOT,
    Figures,
    code_hash,
    finish,
    one_blas_thread,
)
from benchmarks.seeded import read_options, save_rows, seed_range, seeded_options
from flows.keep.method import method_hash
from flows.workers.pool import Here, Pool

_SEEDS, _QUICK_SEEDS = "8001:8010", "1:1"
_GROUPS = (*cases.GROUPS, "measured", "cost")
_OWN = ("arms.py", "cases.py", "measured.py")


def main() -> int:
    """Run the groups and return the exit code."""
    args = _arguments()
    # For the pool: its processes load NumPy after this.
    one_blas_thread()
    wanted = [g for g in cases.GROUPS if g in args.groups]
    deciding = args.seeds == _SEEDS and not args.quick
    figures: Figures = {}
    with Kept(args.keep or _kept()) as known:
        if "cost" in args.groups:
            # Alone on the machine, before any other process is there.
            figures |= bars.cost_figures(_run_cost(args, known), deciding)
        with Pool(args.workers) as pool:
            rows = _run_cases(args, wanted, known, pool)
            results = _run_measured(args, known, pool)
    if wanted:
        figures |= bars.case_figures(rows, deciding)
    if "measured" in args.groups:
        figures |= measured.measured_figures(results)
    save_rows(args, figures, cases=rows, measured=results)
    return finish(figures)


def _arguments() -> argparse.Namespace:
    quick = "a handful of short logs"
    parser = seeded_options(__doc__, _SEEDS, _GROUPS, quick)
    text = "kinds of arms, where not all: pybullet, seven, other"
    parser.add_argument("--arms", nargs="*", metavar="KIND", help=text)
    parser.add_argument("--workers", type=int, default=2, help="processes")
    return read_options(parser, _QUICK_SEEDS)


def _run_cases(
    args: argparse.Namespace, groups: Sequence[str], known: Kept, pool: Pool
) -> Mapping[str, list]:
    """Run the cases of all groups, those that say sizes first."""
    seeds = seed_range(args.seeds)
    wanted = {
        group: [
            task
            for task in cases.tasks(group, seeds, args.quick)
            if not args.arms or task.data in args.arms
        ]
        for group in groups
    }
    every = [task for tasks in wanted.values() for task in tasks]
    benches = {b.name: (b, ()) for b in cases.benches(every)}
    sizes = known.run(pool, cases.run, benches)
    for name, row in sizes.items():
        if "error" in row:
            raise SystemExit(f"{name} failed: no sizes known. {row['error']}")
    jobs = {t.name: (t, sizes.get(t.bench, {}).get("minimum", ())) for t in every}
    rows = known.run(pool, cases.run, jobs)
    return {group: [rows[t.name] for t in tasks] for group, tasks in wanted.items()}


def _run_measured(args: argparse.Namespace, known: Kept, pool: Pool) -> list[dict]:
    jobs = measured.jobs(args.quick) if "measured" in args.groups else []
    named = {f"measured {' '.join(job)}": job for job in jobs}
    done = known.run(pool, measured.run, named)
    return [done[name] for name in named]


def _run_cost(args: argparse.Namespace, known: Kept) -> list[tuple]:
    pairs = cases.cost_tasks(seed_range(args.seeds), args.quick)
    jobs = {task.name: (task, ()) for pair in pairs for task in pair}
    done = known.run(Here(), cases.run, jobs)
    return [tuple(done[task.name] for task in pair) for pair in pairs]


def _kept() -> Path:
    """Return where cases of this very code are kept."""
    total = hashlib.sha256(method_hash().encode())
    for name in _OWN:
        total.update((ROOT / "benchmarks" / "dirty_parts" / name).read_bytes())
    name = f"dirty-{code_hash()}-{total.hexdigest()[:8]}.jsonl"
    return ROOT / "store" / "benchmarks" / name


if __name__ == "__main__":
    sys.exit(main())
