"""What changed, exactly: is the whole set of changes named, and nothing else?

    python benchmarks/attribution.py --quick                     under 50 s on two cores
    python benchmarks/attribution.py --seeds 1:2 --groups sets      to look at
    python benchmarks/attribution.py --full-json benchmarks/results/attribution.json

A load, links 8 to 25 % off and friction on an arm of seven joints whose given values
are exact, sized by what they do to its torque (`sets`). And two kinds of arms, of six
and of seven joints, whose given inertias, friction and rotors are exact or 1, 3 or 10 %
off; none to four changes, each of three times the size that the diagnosis says these
logs would show of the same arm, or more (of the first seed, for time). What the
nominal is off by is no change: to name it counts as false. Seeds 123101:123109 decide
and are used for nothing else; 1 to 99 are for development. Finished cases are kept in
store/benchmarks, by a hash of the code: an interrupted run goes on where it was. The
last line is one JSON object; exit code 1 for a missed bar.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.attribution_parts import bars, cases
from benchmarks.harness import cases as harness
from benchmarks.harness.figures import finish, one_blas_thread
from flows.workers.processes import Processes

_SEEDS = "123101:123109"


def main() -> int:
    args = harness.read_options(__doc__, _SEEDS, cases.GROUPS)
    # For the pool: its processes load NumPy after this.
    one_blas_thread()
    place = harness.kept_file("attribution", "benchmarks/attribution_parts")
    with Processes(2) as pool:
        rows = _run(
            args, partial(harness.run_kept, place, cases.words, pool, cases.run)
        )
    figures = bars.case_figures(rows, args.deciding)
    harness.save_rows(args, figures, cases=rows)
    return finish(figures)


def _run(args: argparse.Namespace, run_all: Callable) -> Mapping[str, Sequence]:
    """Run the cases of all groups; the unchanged arms, which say the sizes, first."""
    seeds = harness.seed_range(args.seeds)
    groups = [group for group in cases.GROUPS if group in args.groups]
    wanted = {group: cases.tasks(group, seeds, args.quick) for group in groups}
    changed = wanted.get(cases.CHANGED, [])
    first = [*wanted.get(cases.UNCHANGED, []), *cases.benches(changed)]
    rows = run_all({t.name: (t, ()) for t in first})
    sizes = {name: row["minimum"] for name, row in rows.items() if "minimum" in row}
    jobs = {t.name: (t, sizes[t.bench]) for t in changed if t.bench in sizes}
    # Sized by what they do to the torque, not by what the diagnosis would see.
    jobs |= {t.name: (t, ()) for t in wanted.get(cases.SETS, [])}
    lost = {"error": "no sizes known: its unchanged arm crashed"}
    rows |= dict.fromkeys((t.name for t in changed), lost) | run_all(jobs)
    return {group: [rows[t.name] for t in own] for group, own in wanted.items()}


if __name__ == "__main__":
    sys.exit(main())
