"""Other programs on the same sealed cases: what does each say, and is it so?

    python benchmarks/peers.py --quick                          two short cases
    python benchmarks/peers.py --seeds 1:1 --groups squares sparse      to look at
    python benchmarks/peers.py --full-json benchmarks/results/peers.json

Each seed is a study as `modelgap blind --export` writes it: ten cases, of the built-in
arm for odd seeds, of a drawn one for even ones. Programs read the folder `open` alone:
ours, plain least squares, and a sparse selection after SAPC: our reading of its
description, not that program. Seeds 114101:114102 decide and are used for nothing else;
1 to 99 are for development. Studies and finished cases are kept in store/benchmarks, by
a hash of the code: an interrupted run goes on where it was, and --minutes ends one with
the last case begun in that time. The last line is one JSON object.
"""

import argparse
import sys
from pathlib import Path
from time import monotonic

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.harness.cases import (
    Kept,
    kept_file,
    read_options,
    save_rows,
    seed_range,
    seeded_options,
)
from benchmarks.harness.figures import finish, one_blas_thread
from benchmarks.peers_parts import bars, cases
from flows.blind.draw import Asked
from flows.blind.export.write import export_study
from flows.workers.pool import Pool
from sim.engine.records import BACKGROUNDS, CLEAN

_SEEDS, _QUICK_SEEDS = "114101:114102", "1:1"
_FULL, _QUICK = (10, 20.0), (2, 8.0)  # cases, seconds of a log


def main() -> int:
    """Export the studies, let every program answer, and return the exit code."""
    args = _arguments()
    # For the pool: its processes load NumPy after this.
    one_blas_thread()
    until = monotonic() + 60 * args.minutes
    size = f"{args.background}-quick" if args.quick else args.background
    parts = ("benchmarks/peers_parts", "flows/blind/export")
    place = args.keep or kept_file(f"peers-{size}", *parts)
    rows: dict[str, list] = {program: [] for program in args.groups}
    with Kept(place, cases.words) as known, Pool(args.workers) as pool:
        for seed in seed_range(args.seeds):
            if monotonic() < until:
                folder = _exported(args, seed, place.with_suffix(""), pool)
                _answered((args.groups, seed, folder), known, pool, rows, until)
    done = {program: own for program, own in rows.items() if own}
    figures, tables = bars.all_figures(done), bars.tables(done)
    save_rows(args, figures, cases=done, tables=tables)
    for table in tables:
        print("\n" + table["title"])
        print("\n".join(" | ".join(row) for row in table["rows"]))
    return finish(figures)


def _arguments() -> argparse.Namespace:
    quick = "two short cases"
    parser = seeded_options(__doc__, _SEEDS, tuple(cases.PROGRAMS), quick)
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--minutes", type=float, default=1e6, help="of work, about")
    text = "what all joints have beside what is hidden"
    parser.add_argument("--background", default=CLEAN, choices=BACKGROUNDS, help=text)
    return read_options(parser, _QUICK_SEEDS)


def _exported(args: argparse.Namespace, seed: int, place: Path, pool: Pool) -> Path:
    """Return the study of a seed; one that was written is not written again."""
    folder = place / f"seed_{seed}"
    if not folder.is_dir():
        place.mkdir(parents=True, exist_ok=True)
        count, seconds = _QUICK if args.quick else _FULL
        asked = Asked(count, seed, duration=seconds, background=args.background)
        arm = (seed + 1) % 2  # the built-in one is 0
        export_study(asked, (arm,), folder, place / "store", pool, _tell)
    return folder


def _tell(what: str, share: float) -> None:
    print(what, flush=True)


def _answered(
    wanted: tuple, known: Kept, pool: Pool, rows: dict[str, list], until: float
) -> None:
    """Let the programs answer case by case, so that a run may be cut."""
    programs, seed, folder = wanted
    for case in cases.names(folder):
        if monotonic() > until:
            print(f"cut before seed {seed} {case}", flush=True)
            return
        tasks = [cases.Task(p, seed, case, str(folder)) for p in programs]
        done = known.run(pool, cases.run, {task.name: task for task in tasks})
        for task in tasks:
            rows[task.program].append(done[task.name])


if __name__ == "__main__":
    sys.exit(main())
