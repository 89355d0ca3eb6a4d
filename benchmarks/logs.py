"""Does it name what a log's model lacks? Measured logs, synthetic arms, cost.

    python benchmarks/logs.py --quick                     under 50 s on two cores
    python benchmarks/logs.py --seeds 1:5                 to tune on; never 1001:1020
    python benchmarks/logs.py --full-json benchmarks/results/logs.json

Finished cases are kept in store/benchmarks, by a hash of the code: an interrupted run
goes on where it was. The last line is one JSON object; exit code 1 for a missed bar.
"""

import argparse
import json
import multiprocessing
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.figures import (
    ROOT,
    Figures,
    circumstances,
    code_hash,
    finish,
    one_blas_thread,
    save,
)
from benchmarks.logs_parts import measured, shell, singles

_SEEDS = "1001:1020"
_QUICK_SEED = 1  # not one of those that decide
_QUICK_EFFECTS = ("payload", "stribeck", None)


def main() -> int:
    """Run the groups and return the exit code."""
    args = _arguments()
    figures: Figures = {}
    if "cost" in args.groups:
        figures |= shell.shell_figures(1 if args.quick else 3)
    # For the pool: its processes load NumPy after this.
    one_blas_thread()
    splits = _splits(args) if "measured" in args.groups else []
    tasks = _tasks(args) if "singles" in args.groups else []
    results = {"measured": [], "singles": []}
    with _Kept(code_hash()) as kept:
        for kind, result in kept.run(splits, tasks):
            results[kind].append(result)
            if kind == "measured":
                measured.show_measured(result)
    if "measured" in args.groups:
        figures |= measured.measured_figures(results["measured"], args.quick)
    if tasks:
        singles.show_singles(results["singles"])
        small = args.quick or args.seeds != _SEEDS or bool(args.effects)
        figures |= singles.singles_figures(results["singles"], small)
    if args.full_json:
        facts = circumstances(seeds=args.seeds, quick=args.quick)
        save(args.full_json, {**facts, "figures": figures, **results})
    return finish(figures)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a part, under 50 s")
    parser.add_argument("--seeds", default=_SEEDS, metavar="A:B", help="both included")
    parser.add_argument("--effects", nargs="*", help="some hidden effects; 'none' too")
    parser.add_argument("--full-json", type=Path, metavar="FILE")
    parser.add_argument(
        "--groups",
        nargs="*",
        default=["cost", "measured", "singles"],
        choices=["cost", "measured", "singles"],
    )
    return parser.parse_args()


def _splits(args: argparse.Namespace) -> list[str]:
    if measured.data_folder() is None:
        return []
    rotations = measured.ROTATIONS[:1] if args.quick else measured.ROTATIONS
    # The longest first, so that the pool ends together.
    return ["UR10", *rotations]


def _tasks(args: argparse.Namespace) -> list[tuple[str | None, int]]:
    if args.quick:
        return [(effect, _QUICK_SEED) for effect in _QUICK_EFFECTS]
    first, last = (int(word) for word in args.seeds.split(":"))
    seeds = range(first, last + 1)
    chosen = args.effects or [*singles.EFFECTS, "none"]
    tasks = [(e, s) for s in seeds for e in chosen if e != "none"]
    # Twice as many nulls as draws of one effect: 40 for 20.
    nulls = range(first, first + 2 * len(seeds))
    return tasks + [(None, s) for s in nulls if "none" in chosen]


class _Kept:
    """Results that outlive an interruption, one JSON line per case."""

    def __init__(self, version: str) -> None:
        folder = ROOT / "store" / "benchmarks"
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / f"logs-{version}.jsonl"
        self._known: dict[str, dict] = {}

    def __enter__(self) -> "_Kept":
        if self._path.exists():
            for line in self._path.read_text(encoding="utf-8").splitlines():
                self._known.update(json.loads(line))
        self._file = self._path.open("a", encoding="utf-8")
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def run(self, splits: list[str], tasks: list) -> Iterator[tuple[str, dict]]:
        """Yield the results of all jobs, in their order, in a pool of two."""
        jobs = {f"measured {s}": (measured.measure, s) for s in splits}
        jobs |= {f"{e or 'none'} {s}": (singles.run_single, (e, s)) for e, s in tasks}
        open_jobs = {k: v for k, v in jobs.items() if k not in self._known}
        if len(open_jobs) < len(jobs):
            print(f"{len(jobs) - len(open_jobs)} of {len(jobs)} cases known already")
        for i, (name, result) in enumerate(_pooled(open_jobs.items()), start=1):
            self._known[name] = result
            self._file.write(json.dumps({name: result}) + "\n")
            self._file.flush()
            print(f"[{i}/{len(open_jobs)}] {name}: {_words(result)}", flush=True)
        for name in jobs:
            kind = "measured" if name.startswith("measured ") else "singles"
            yield kind, self._known[name]


def _pooled(
    jobs: Iterable[tuple[str, tuple[Callable, object]]],
) -> Iterator[tuple[str, dict]]:
    """Yield results as they come, from two processes of one BLAS thread each."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        futures = {pool.submit(job, what): name for name, (job, what) in jobs}
        for future in as_completed(futures):
            yield futures[future], future.result()


def _words(result: dict) -> str:
    if "split" in result:
        return f"{len(result['effects'])} named, {result['seconds']} s"
    return f"{result['score']}, {singles.told(result)}"


if __name__ == "__main__":
    sys.exit(main())
