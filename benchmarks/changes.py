"""What changed between an earlier state of an arm and its new logs: is it found?

    python benchmarks/changes.py --quick                     a handful of short logs
    python benchmarks/changes.py --seeds 1:1 --groups change measured_change
    python benchmarks/changes.py --list             the list of the seeds that decide
    python benchmarks/changes.py --full-json benchmarks/results/changes.json

A change's size is the RMS of its torque over that of the joint, never a multiple of
what the program says; only `edge` asks the program. Silence is a miss. Seeds
121101:121104 decide and are used for nothing else, and their cases are listed in
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

from benchmarks.changes_parts import ask, bars, cases, real
from benchmarks.changes_parts.case import GROUPS, MEASURED, Case
from benchmarks.harness import cases as harness
from benchmarks.harness.figures import Figures, finish, one_blas_thread
from benchmarks.harness.origin import ROOT
from benchmarks.measured_parts.arms import absent
from flows.workers.processes import Processes

_QUICK_GROUPS = ("unchanged", "change", "measured_change")
_ASKED = (*cases.OWN, "ask.py", "peer.py")


def main() -> int:
    quick, text = "a handful of short logs, under 50 s", "only write the deciding list"
    args = harness.read_options(__doc__, cases.DECIDING, GROUPS, quick, list=text)
    if args.quick and args.groups == list(GROUPS):
        args.groups = list(_QUICK_GROUPS)
    # For the pool: its processes load NumPy after this.
    one_blas_thread()
    with Processes(2) as pool:
        if args.list:
            many = cases.write_list(cases.DECIDING, pool)
            print(f"{many} cases in {cases.LIST.relative_to(ROOT)}")
            return 0
        if args.deciding and not cases.LIST.exists():
            raise SystemExit("The deciding cases are not listed: --list, then commit.")
        rows = _rows(_listed(args, pool), pool)
    figures = bars.all_figures(rows, args.deciding) | _absent(args)
    harness.save_rows(args, figures, cases=rows)
    return finish(figures)


def _listed(args: argparse.Namespace, pool: Processes) -> list[Case]:
    """Return the cases of all groups, before any method sees one."""
    seeds = harness.seed_range(args.seeds)
    return [
        case
        for group in GROUPS
        if group in args.groups
        for case in cases.listed(group, seeds, args.quick, pool)
    ]


def _rows(listed: Sequence[Case], pool: Processes) -> list[Mapping]:
    """Return a row of each case by each method, ours and the peer's."""
    plan = [f"benchmarks/changes_parts/{name}" for name in _ASKED]
    kept = harness.kept_file("changes", *plan, *cases.BELOW)
    done = harness.run_kept(kept, ask.words, pool, ask.run, {c.name: c for c in listed})
    rows: list[Mapping] = []
    for case in listed:
        result = done[case.name]
        if "rows" in result:
            rows += result["rows"]
        else:  # a process took it with it: no method said anything
            rows += [ask.nothing(case, m) | result for m in ask.methods_of(case)]
    return rows


def _absent(args: argparse.Namespace) -> Figures:
    """Return what could not be measured since its logs are not on this machine."""
    if not set(args.groups) & set(MEASURED):
        return {}
    arms = [arm for arm in real.ARMS if absent(arm)]
    why = f"no measured logs of {', '.join(arms)}"
    return {"measured_absent": bars.absent(len(arms), len(real.ARMS), why)}


if __name__ == "__main__":
    sys.exit(main())
