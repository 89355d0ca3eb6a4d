"""Does the check find what is wrong with a log, mend it, and leave sound ones alone?

    python benchmarks/check.py --quick                    under 50 s on two cores
    python benchmarks/check.py --seeds 1:2                to look at
    python benchmarks/check.py --full-json benchmarks/results/check.json

Every kind of fault is put into logs of simulated and measured arms, at three sizes or
six (two kinds have six). Sound logs are some in which a joint is held, too.
Seeds 122101:122104 decide and are used for nothing else; 1 to 99 are for development.
Finished jobs are kept in store/benchmarks, by a hash of the code. The last line is one
JSON object; exit code 1 for a missed bar.
"""

import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.check_parts import bars, cases
from benchmarks.harness import cases as harness
from benchmarks.harness.figures import finish, one_blas_thread
from flows.workers.processes import Processes

_SEEDS = "122101:122104"
_GROUPS = ("faults", "clean", "effects", "trusted")


def main() -> int:
    args = harness.read_options(__doc__, _SEEDS, _GROUPS)
    wanted = cases.tasks(harness.seed_range(args.seeds), args.quick)
    jobs = {t.name: t for t in wanted if t.group in args.groups}
    one_blas_thread()
    place = harness.kept_file(
        "check", "benchmarks/check_parts", "flows/inputs", "flows/steps"
    )
    with Processes(2) as pool:
        done = harness.run_kept(place, lambda result: "done", pool, cases.run, jobs)
    rows = [row for result in done.values() for row in result.get("rows", ())]
    lost = [{"error": r["error"], "group": n} for n, r in done.items() if "error" in r]
    absent = sorted({r["absent"] for r in done.values() if "absent" in r})
    figures = bars.figures([*rows, *lost], absent, args.whole)
    _show(rows)
    harness.save_rows(args, figures, cases=rows)
    return finish(figures)


def _show(rows: list[dict]) -> None:
    """Print one line per kind of fault, and what was missed."""
    told: dict[str, Counter] = {}
    for row in rows:
        if "hit" in row:
            told.setdefault(row["kind"], Counter())[row["hit"]] += 1
    for kind, counts in told.items():
        print(f"{kind:18} {counts[True]:4} of {counts.total()}")
    for row in rows:
        if "error" in row or ("hit" in row and not row["hit"]):
            where = f"{row['host']} {row['seed']} size {row.get('size')}"
            what = row.get("error") or row["said"]
            print(f"  {row.get('kind')} {row.get('joints')} on {where}: {what}")


if __name__ == "__main__":
    sys.exit(main())
