"""Other programs on the same sealed cases: what does each say, and is it so?

    python benchmarks/peers.py --quick                          two short cases
    python benchmarks/peers.py --seeds 1:1 --groups squares sparse      to look at
    python benchmarks/peers.py --full-json benchmarks/results/peers.json

Each seed is a study as `modelgap blind --export` writes it: ten cases, of the built-in
arm for odd seeds, of a drawn one for even ones. Programs read the folder `open` alone:
ours, plain least squares, and a sparse selection after SAPC: our reading of its
description, not that program. Seeds 124101:124102 decide and are used for nothing else
(where its arm can make no motion of a kind, the second seed after, and so on); 1 to 99
are for development. Studies and finished cases are kept in store/benchmarks, by
a hash of the code: an interrupted run goes on where it was. The last line is one JSON
object.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness import cases as harness
from benchmarks.harness.figures import finish, one_blas_thread
from benchmarks.peers_parts import bars, cases
from flows.blind.draw import StudyRequest
from flows.blind.export.write import export_study
from flows.workers.pool import Pool
from residual.errors import RunError
from sim.engine.records import CLEAN

_SEEDS = "124101:124102"
_TRIES = 5
_FULL, _QUICK = (10, 20.0), (2, 8.0)  # cases, seconds of a log


def main() -> int:
    args = harness.read_options(
        __doc__, _SEEDS, tuple(cases.PROGRAMS), "two short cases"
    )
    # For the pool: its processes load NumPy after this.
    one_blas_thread()
    name = f"peers-{CLEAN}-quick" if args.quick else f"peers-{CLEAN}"
    place = harness.kept_file(name, "benchmarks/peers_parts", "flows/blind/export")
    rows: dict[str, list] = {program: [] for program in args.groups}
    with Pool(2) as pool:
        for first in harness.seed_range(args.seeds):
            seed, folder = _study(args.quick, first, place.with_suffix(""), pool)
            tasks = [
                cases.Task(program, seed, case, str(folder))
                for case in cases.names(folder)
                for program in args.groups
            ]
            jobs = {task.name: task for task in tasks}
            done = harness.run_kept(place, cases.words, pool, cases.run, jobs)
            for task in tasks:
                rows[task.program].append(done[task.name])
    figures, tables = bars.all_figures(rows), bars.tables(rows)
    harness.save_rows(args, figures, cases=rows, tables=tables)
    for table in tables:
        print("\n" + table["title"])
        print("\n".join(" | ".join(row) for row in table["rows"]))
    return finish(figures)


def _study(quick: bool, seed: int, place: Path, pool: Pool) -> tuple[int, Path]:
    """Return the first study from a seed on whose arm can make all motions, its seed.

    Some drawn arms reach no place for a work piece: every second seed draws one.
    """
    for own in range(seed, seed + 2 * _TRIES, 2):
        try:
            return own, _exported(quick, own, place, pool)
        except RunError as error:
            print(f"seed {own}: {error}", flush=True)
    raise RunError(f"No arm of {_TRIES} from seed {seed} on can make all motions.")


def _exported(quick: bool, seed: int, place: Path, pool: Pool) -> Path:
    """Return the study of a seed; one that was written is not written again."""
    folder = place / f"seed_{seed}"
    if not folder.is_dir():
        place.mkdir(parents=True, exist_ok=True)
        count, seconds = _QUICK if quick else _FULL
        asked = StudyRequest(count, seed, duration=seconds, background=CLEAN)
        arm = (seed + 1) % 2  # the built-in one is 0
        export_study(asked, (arm,), folder, place / "store", pool, _tell)
    return folder


def _tell(what: str, share: float) -> None:
    print(what, flush=True)


if __name__ == "__main__":
    sys.exit(main())
