"""Does the demonstration find what its arm hides, and what does it cost?

    python benchmarks/demo.py --quick                     under 50 s on two cores
    python benchmarks/demo.py --seeds 1:20                to tune on; never 1001:1020
    python benchmarks/demo.py --effect each --seeds 200:223 --nulls 0      all in turn
    python benchmarks/demo.py --full-json benchmarks/results/demo.json

Finished seeds are kept in store/benchmarks, by a hash of the code: an interrupted run
goes on where it was. The last line is one JSON object; exit code 1 for a missed bar.
"""

import argparse
import hashlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.demo_parts import command, pipeline
from benchmarks.figures import (
    ROOT,
    Figures,
    circumstances,
    code_hash,
    finish,
    missing,
    one_blas_thread,
    save,
)
from flows.settings import cores
from flows.steps import demo
from flows.workers.pool import Pool
from sim.draw import usual_effects

_SEEDS, _NULLS = "1001:1020", 10
_QUICK = "the full run decides"
_EACH = "each"  # as --effect: all effects that are drawn unasked, in turn


def main() -> int:
    """Run the groups and return the exit code."""
    args = _arguments()
    figures: Figures = {}
    if "command" in args.groups:
        figures |= command.command_figures()
    records: list[dict] = []
    if args.quick:
        figures |= _not_measured()
    elif "pipeline" in args.groups:
        one_blas_thread()
        records = list(_run(_tasks(args)))
        drawn = args.effect is None
        deciding = args.seeds == _SEEDS and args.nulls >= _NULLS and drawn
        figures |= pipeline.pipeline_figures(records, deciding)
    if args.full_json:
        facts = circumstances(seeds=args.seeds, quick=args.quick)
        save(args.full_json, {**facts, "figures": figures, "pipeline": records})
    return finish(figures)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a part, under 50 s")
    parser.add_argument("--seeds", default=_SEEDS, metavar="A:B", help="both included")
    parser.add_argument("--nulls", type=int, default=_NULLS, help="how many")
    parser.add_argument("--effect", help=f"hide this one, or '{_EACH}'")
    parser.add_argument("--full-json", type=Path, metavar="FILE")
    groups = ["command", "pipeline"]
    parser.add_argument("--groups", nargs="*", default=groups, choices=groups)
    return parser.parse_args()


def _tasks(args: argparse.Namespace) -> list[tuple[int, str | None]]:
    first, last = (int(word) for word in args.seeds.split(":"))
    names = usual_effects() if args.effect == _EACH else [args.effect]
    tasks: list = [
        (seed, names[i % len(names)]) for i, seed in enumerate(range(first, last + 1))
    ]
    return tasks + [(seed, demo.NOTHING) for seed in range(first, first + args.nulls)]


def _run(tasks: list[tuple[int, str | None]]) -> Iterator[dict]:
    """Yield the record of every task; those of the same code are not run again."""
    # The experiments are no part of the hash that all benchmarks share.
    plan = hashlib.sha256(Path(demo.__file__).read_bytes()).hexdigest()[:8]
    kept = ROOT / "store" / "benchmarks" / f"demo-{code_hash()}-{plan}.jsonl"
    kept.parent.mkdir(parents=True, exist_ok=True)
    lines = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
    known = {tuple(task): record for task, record in map(json.loads, lines)}
    left = [task for task in tasks if task not in known]
    with Pool(cores()) as pool, kept.open("a", encoding="utf-8") as file:
        for count, done in enumerate(pool.run(pipeline.run_seed, left), start=1):
            task, record = left[done.index], done.value
            if done.error:
                error = str(done.error)
                record = {"seed": task[0], "null": task[1] == demo.NOTHING}
                record |= {"truth": None, "score": "crash", "error": error}
            known[task] = record
            file.write(json.dumps([task, record]) + "\n")
            file.flush()
            print(f"[{count}/{len(left)}] {pipeline.show_line(record)}", flush=True)
    yield from (known[task] for task in tasks)


def _not_measured() -> Figures:
    bars = {
        "plain_right": pipeline.RIGHT_OF_20,
        "plain_wrong": pipeline.WRONG_OF_20,
        "nulls_named": 0,
    }
    return {name: missing(bar, _QUICK) for name, bar in bars.items()}


if __name__ == "__main__":
    sys.exit(main())
