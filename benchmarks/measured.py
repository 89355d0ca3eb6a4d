"""Logs and robot files of other people: our models beside peers and weighed loads.

    python benchmarks/measured.py --groups splits      after a change of the method
    python benchmarks/measured.py --quick              four splits, two packages
    python benchmarks/measured.py --full-json benchmarks/results/measured.json

`splits`: measured arms, fitted and held out; beside ours plain least squares of all
inertial parameters, friction and constants, and the paper's PLSR. `added`: the same
logs with a known effect added, of those that an oracle hears the first names against
other new ones, beside a greedy selection; `--seeds 820:820 --groups added` on other
draws. `files`: robot files of installed packages.
"""

import sys
from collections.abc import Mapping
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.cases import kept_file, run_kept, seed_range
from benchmarks.harness.figures import Figures, finish, read_options
from benchmarks.measured_parts import added, arms, bars, files

_SEEDS = "166703:166703"  # of the added effects
QUICK = ("ur10 60 % | 40 %", "kr300 AB | C", "ur10e feb10 | other days", arms.LOADED)


def main() -> int:
    args = read_options(__doc__, ("splits", "added", "files"), _SEEDS)
    path = kept_file("measured", "benchmarks/measured_parts", "benchmarks/changes_parts")
    figures: Figures = {}
    rows: dict[str, list] = {}
    each = [case for seed in seed_range(args.seeds) for case in added.cases(seed)]
    todo = {
        "splits": {name: name for name in (QUICK if args.quick else arms.SPLITS)},
        "added": {} if args.quick else {case.name: case for case in each},
    }
    work = {"splits": (_summary, arms.measure), "added": (added.summary, added.measure)}
    make = {"splits": bars.split_figures, "added": bars.added_figures}
    for group in (name for name in todo if name in args.groups):
        jobs = {k: v for k, v in todo[group].items() if not _is_absent(v)}
        done = run_kept(path, *work[group], jobs, processes=args.processes)
        failed = [f"{k}: {row['error']}" for k, row in done.items() if "error" in row]
        if failed:
            raise SystemExit("; ".join(failed))
        rows[group] = list(done.values())
        figures |= make[group](rows[group])
    if rows.get("added"):
        print(*bars.curve(rows["added"]), sep="\n")
    if "files" in args.groups:
        figures |= files.figures(args.quick)
    return finish(args, figures, **rows)


def _is_absent(job: str | added.Case) -> bool:
    return arms.absent(arms.SPLITS[job if isinstance(job, str) else job.split].arm)


def _summary(row: Mapping) -> str:
    named = ", ".join(f"{name} {joints}" for name, joints in row["named"])
    return f"{named or row['verdict']} ({row['seconds']} s)"


if __name__ == "__main__":
    sys.exit(main())
