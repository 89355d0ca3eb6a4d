"""What changed, exactly: is the whole set of changes named, and nothing else?

    python benchmarks/attribution.py --quick                     under 50 s on two cores
    python benchmarks/attribution.py --seeds 1:2 --arms seven --off 10     to look at
    python benchmarks/attribution.py --full-json benchmarks/results/attribution.json

A load, links 8 to 25 % off and friction on an arm of seven joints whose given values
are exact, sized by what they do to its torque (`sets`). And two kinds of arms, of six
and of seven joints, whose given inertias, friction and rotors are exact or 1, 3 or 10 %
off; none to four changes, each of three times the size that the diagnosis says these
logs would show of the same arm, or more (of the first seed, for time). What the
nominal is off by is no change: to name it counts as false. Seeds 113101:113113 decide
and are used for nothing else; 1 to 99 are for development. Finished cases are kept in
store/benchmarks, by a hash of the code: an interrupted run goes on where it was. The
last line is one JSON object; exit code 1 for a missed bar.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.attribution_parts import bars, cases
from benchmarks.harness.cases import (
    Kept,
    kept_file,
    read_options,
    save_rows,
    seed_range,
    seeded_options,
)
from benchmarks.harness.figures import Figures, finish, one_blas_thread
from flows.workers.pool import Pool

_SEEDS, _QUICK_SEEDS = "113101:113113", "1:1"


def main() -> int:
    """Run the groups and return the exit code."""
    args = _arguments()
    # For the pool: its processes load NumPy after this.
    one_blas_thread()
    deciding = args.seeds == _SEEDS and not args.quick and not (args.arms or args.off)
    place = args.keep or kept_file("attribution", "benchmarks/attribution_parts")
    with Kept(place, cases.words) as known, Pool(args.workers) as pool:
        rows = _run(args, known, pool)
    figures: Figures = bars.case_figures(rows, deciding)
    save_rows(args, figures, cases=rows)
    return finish(figures)


def _arguments() -> argparse.Namespace:
    parser = seeded_options(__doc__, _SEEDS, cases.GROUPS)
    parser.add_argument("--arms", nargs="*", choices=cases.KINDS, help="not all")
    text = "per cent that given values are off, where not all: 0, 1, 3, 10"
    parser.add_argument("--off", nargs="*", type=int, help=text)
    parser.add_argument("--counts", nargs="*", type=int, help="of changes, not all")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    return read_options(parser, _QUICK_SEEDS)


def _wanted(args: argparse.Namespace, group: str) -> list[cases.Task]:
    return [
        task
        for task in cases.tasks(group, seed_range(args.seeds), args.quick)
        if (not args.arms or task.arm in args.arms)
        and (not args.off or task.off in args.off)
        and (not args.counts or task.count in (0, *args.counts))
    ]


def _run(args: argparse.Namespace, known: Kept, pool: Pool) -> Mapping[str, Sequence]:
    """Run the cases of all groups; the unchanged arms, which say the sizes, first."""
    wanted = {g: _wanted(args, g) for g in cases.GROUPS if g in args.groups}
    changed = wanted.get(cases.CHANGED, [])
    first = [*wanted.get(cases.UNCHANGED, []), *cases.benches(changed)]
    still = known.run(pool, cases.run, {t.name: (t, ()) for t in first})
    sizes = {name: row["minimum"] for name, row in still.items() if "minimum" in row}
    jobs = {t.name: (t, sizes[t.bench]) for t in changed if t.bench in sizes}
    # Sized by what they do to the torque, not by what the diagnosis would see.
    jobs |= {t.name: (t, ()) for t in wanted.get(cases.SETS, [])}
    rows = known.run(pool, cases.run, jobs)
    lost = {"error": "no sizes known: its unchanged arm crashed"}
    out = {}
    if cases.UNCHANGED in wanted:
        out[cases.UNCHANGED] = [still[t.name] for t in wanted[cases.UNCHANGED]]
    if cases.CHANGED in wanted:
        out[cases.CHANGED] = [rows.get(t.name, lost) for t in changed]
    if cases.SETS in wanted:
        out[cases.SETS] = [rows[t.name] for t in wanted[cases.SETS]]
    return out


if __name__ == "__main__":
    sys.exit(main())
