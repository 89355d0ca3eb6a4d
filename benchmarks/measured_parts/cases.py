"""Cases of measured arms: splits of their logs, and effects added to them."""

import argparse
from collections.abc import Mapping

from benchmarks.harness.cases import named, seed_range
from benchmarks.measured_parts import added, arms

GROUPS = ("splits", "added", "files")
QUICK = ("ur10 60 % | 40 %", "kr300 AB | C", "ur10e feb10 | other days", arms.LOADED)
Job = str | added.Case


def jobs(args: argparse.Namespace) -> dict[str, Job]:
    """Return what logs there are for; a quick run has four splits."""
    out: dict[str, Job] = {}
    if "splits" in args.groups:
        out |= {name: name for name in (QUICK if args.quick else arms.SPLITS)}
    if "added" in args.groups and not args.quick:
        out |= named(case for seed in seed_range(args.seeds) for case in added.cases(seed))
    return {name: job for name, job in out.items() if not _is_absent(job)}


def _is_absent(job: Job) -> bool:
    return arms.absent(arms.SPLITS[job if isinstance(job, str) else job.split].arm)


def run(job: Job) -> dict:
    return arms.measure(job) if isinstance(job, str) else added.measure(job)


def summary(row: Mapping) -> str:
    if "truth" in row:
        return added.summary(row)
    names = ", ".join(f"{name} {joints}" for name, joints in row["named"])
    return f"{names or row['verdict']} ({row['seconds']} s)"
