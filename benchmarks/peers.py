"""Other programs on the same hidden effects: what does each say, and is it so?

    python benchmarks/peers.py --quick                          two short cases
    python benchmarks/peers.py --seeds 1:1 --groups squares sparse      to look at
    python benchmarks/peers.py --full-json benchmarks/results/peers.json

Each seed is ten cases in the physics engine, of the built-in arm for odd seeds, of a
drawn one for even ones. Programs get what anybody may know of a case: ours, plain least
squares, and a sparse selection after SAPC: our reading of its description, not that
program. Seeds 124101:124102 decide and are used for nothing else (where its arm can
make no motion of a kind, the second seed after, and so on); 1 to 99 are for
development. Finished cases are kept in store/benchmarks, by a hash of the code: an
interrupted run goes on where it was. The last line is one JSON object.
"""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness import cases as harness
from benchmarks.harness.figures import finish, one_blas_thread
from benchmarks.peers_parts import bars, cases
from flows.workers.processes import Processes

_SEEDS = "124101:124102"
_TRIES = 5
_FULL, _QUICK = (10, 20.0), (2, 8.0)  # cases, seconds of a log


def main() -> int:
    args = harness.read_options(
        __doc__, _SEEDS, tuple(cases.PROGRAMS), "two short cases"
    )
    # For the pool: its processes load NumPy after this.
    one_blas_thread()
    place = harness.kept_file("peers", "benchmarks/peers_parts")
    count, seconds = _QUICK if args.quick else _FULL
    programs = tuple(args.groups)
    rows: dict[str, list] = {program: [] for program in programs}
    with Processes(2) as pool:
        run_all = partial(harness.run_kept, place, cases.words, pool, cases.run)
        for first in harness.seed_range(args.seeds):
            seed, minimum = _begun(run_all, first, seconds)
            names = [f"case_{i + 1:03}" for i in range(count)]
            tasks = [cases.Task(seed, name, seconds, programs) for name in names]
            done = run_all({task.name: (task, minimum) for task in tasks})
            for task in tasks:
                for program in programs:
                    row = done[task.name].get(program, done[task.name])
                    about = {"program": program, "seed": seed, "case": task.case}
                    rows[program].append({**about, **row})
    figures, tables = bars.all_figures(rows), bars.tables(rows)
    harness.save_rows(args, figures, cases=rows, tables=tables)
    for table in tables:
        print("\n" + table["title"])
        print("\n".join(" | ".join(row) for row in table["rows"]))
    return finish(figures)


def _begun(run_all: Callable, seed: int, seconds: float) -> tuple[int, list]:
    """Return the first seed from one on whose arm can make all motions, and its sizes.

    Some drawn arms reach no place for a work piece: every second seed draws one.
    """
    for own in range(seed, seed + 2 * _TRIES, 2):
        task = cases.Task(own, cases.BENCH, seconds)
        (found,) = run_all({task.name: (task, ())}).values()
        if "error" not in found:
            return own, found["minimum"]
        print(f"seed {own}: {found['error']}", flush=True)
    raise SystemExit(f"No arm of {_TRIES} from seed {seed} on can make all motions.")


if __name__ == "__main__":
    sys.exit(main())
