"""What changed between an earlier state of an arm and its new logs: is it found?

    python benchmarks/changes.py --quick                     a handful of short logs
    python benchmarks/changes.py --seeds 1:1 --groups change measured_change
    python benchmarks/changes.py --list             the list of the seeds that decide
    python benchmarks/changes.py --full-json benchmarks/results/changes.json

A change's size is the RMS of its torque over that of the joint, never a multiple of
what the program says; only `edge` asks the program. Silence is a miss. Seeds
111101:111105 decide and are used for nothing else, and their cases are listed in
benchmarks/changes_parts/listed.json before any method has seen one; 1 to 99 are for
development. The peer is a plain regression of both epochs, on the same cases in the
same run. Finished cases are kept in store/benchmarks, by a hash of the code: an
interrupted run goes on where it was. The last line is one JSON object; exit code 1
for a missed bar.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.changes_parts import bars, cases, real
from benchmarks.changes_parts.ask import (
    BENCH,
    METHODS,
    PEER,
    PRODUCT,
    Job,
    nothing,
    run,
    words,
)
from benchmarks.changes_parts.case import EDGE, GROUPS, MEASURED, Case
from benchmarks.harness.cases import (
    Kept,
    kept_file,
    read_options,
    save_rows,
    seed_range,
    seeded_options,
)
from benchmarks.harness.figures import Figures, finish, one_blas_thread
from benchmarks.harness.origin import ROOT
from benchmarks.measured_parts.arms import absent
from flows.workers.pool import Pool

_QUICK_SEEDS = "1:1"
_QUICK_GROUPS = ("unchanged", "change", "measured_change")
_BOTH = "both"


def main() -> int:
    """Run the groups and return the exit code."""
    args = _arguments()
    # For the pool: its processes load NumPy after this.
    one_blas_thread()
    with Pool(args.workers) as pool:
        if args.list:
            many = cases.write_list(cases.DECIDING, pool)
            print(f"{many} cases in {cases.LIST.relative_to(ROOT)}")
            return 0
        listed = _listed(args, pool)
        rows = _rows(args, listed, pool)
    deciding = args.seeds == cases.DECIDING and not args.quick
    figures = bars.all_figures(rows, deciding) | _absent(args)
    save_rows(args, figures, cases=rows)
    return finish(figures)


def _arguments() -> argparse.Namespace:
    quick = "a handful of short logs, under 50 s"
    parser = seeded_options(__doc__, cases.DECIDING, GROUPS, quick)
    text = "what answers; the peer finds one thing at a time"
    parser.add_argument("--method", choices=(*METHODS, _BOTH), default=_BOTH, help=text)
    parser.add_argument("--workers", type=int, default=2, help="processes")
    text = "only write the list of the seeds that decide"
    parser.add_argument("--list", action="store_true", help=text)
    args = read_options(parser, _QUICK_SEEDS)
    if args.quick and args.groups == list(GROUPS):
        args.groups = list(_QUICK_GROUPS)
    if not args.list and args.seeds == cases.DECIDING and not cases.LIST.exists():
        parser.error("the cases that decide are not listed: --list, then commit it")
    return args


def _listed(args: argparse.Namespace, pool: Pool) -> list[Case]:
    """Return the cases of all groups, before any method sees one."""
    seeds = seed_range(args.seeds)
    return [
        case
        for group in GROUPS
        if group in args.groups
        for case in cases.listed(group, seeds, args.quick, pool)
    ]


def _rows(
    args: argparse.Namespace, listed: Sequence[Case], pool: Pool
) -> list[Mapping]:
    """Return a row of each case by each method, ours and the peer's."""
    methods = METHODS if args.method == _BOTH else (args.method,)
    rows: list[Mapping] = []
    for method in methods:
        with Kept(args.keep or _kept(method), words) as known:
            minimum = {}
            # What the program says of an arm is nothing to the peer.
            own = [c for c in listed if method == PRODUCT or c.group != EDGE]
            if method == PRODUCT:
                minimum = _minimum([c for c in own if c.group == EDGE], known, pool)
            jobs = [Job(c, method, minimum.get(c.name, ())) for c in own]
            done = known.run(pool, run, {job.name: job for job in jobs})
            # What a process took with it has no row of its own: it said nothing.
            rows += [{**nothing(job), **done[job.name]} for job in jobs]
    return rows


def _minimum(edge: Sequence[Case], known: Kept, pool: Pool) -> dict[str, tuple]:
    """Return what the program would see of the arm of each case, unchanged."""
    jobs = {job.name: job for job in (Job(case, BENCH) for case in edge)}
    rows = known.run(pool, run, jobs)
    return {
        job.case.name: tuple(
            ((place, tuple(joints)), value)
            for (place, joints), value in rows[name].get("minimum", ())
        )
        for name, job in jobs.items()
    }


def _kept(method: str) -> Path:
    """Return where rows of this very method on these very cases are kept."""
    own = ["peer.py"] if method == PEER else []
    plan = [f"benchmarks/changes_parts/{name}" for name in (*cases.OWN, "ask.py", *own)]
    # The peer does not change with the program.
    code = "peer" if method == PEER else None
    return kept_file(f"changes-{method}", *plan, *cases.BELOW, code=code)


def _absent(args: argparse.Namespace) -> Figures:
    """Return what could not be measured since its logs are not on this machine."""
    if not set(args.groups) & set(MEASURED):
        return {}
    arms = [arm for arm in real.ARMS if absent(arm)]
    why = f"no measured logs of {', '.join(arms)}"
    return {"measured_absent": bars.absent(len(arms), len(real.ARMS), why)}


if __name__ == "__main__":
    sys.exit(main())
