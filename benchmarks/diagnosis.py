"""Is the right effect named, at its joint, and nothing where nothing is?

    python benchmarks/diagnosis.py --quick                     under 50 s on two cores
    python benchmarks/diagnosis.py --seeds 1:2 --groups singles      to look at
    python benchmarks/diagnosis.py --full-json benchmarks/results/diagnosis.json

Seeds 148401:148404 decide and are used for nothing else; 1 to 99 are for development.
Sizes are in minimum detectable ones, as the diagnosis says them of an arm with nothing
hidden in the same motions; those of constants, couplings and loads are physical.
Finished cases are kept in store/benchmarks, by a hash of the code: an interrupted run
goes on where it was. What is taken for what is printed, and with a results file stands
beside it, as FILE_confusion.parquet. The last line is
one JSON object; exit code 1 for a missed bar.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.diagnosis_parts import bars, cases, measured
from benchmarks.harness.cases import (
    kept_file,
    read_options,
    run_kept,
    save_rows,
    seed_range,
)
from benchmarks.harness.figures import (
    Figures,
    all_missing,
    figure,
    finish,
    missing,
    one_blas_thread,
)
from benchmarks.harness.logs import write_csv
from benchmarks.harness.shell import run_shell
from benchmarks.hidden.score import confusion
from benchmarks.synthetic.logs import standard_case
from flows.workers.processes import Processes
from residual.robot.robot import load_robot

_SEEDS = "148401:148404"
_STRANGERS = ("constants", "couplings", "loads")
_CASES = (
    *("singles", "nulls", "unknown", "pairs", "forms", "detection", "known"),
    *_STRANGERS,
)
_GROUPS = (*_CASES, "cost", "measured")
_CONFUSED = ("singles", "nulls", "unknown")  # one thing is hidden, or nothing
_COSTS = {"seconds": 10.0, "peak_gb": 1.0}


def main() -> int:
    """Run the groups and return the exit code."""
    args = read_options(__doc__, _SEEDS, _GROUPS)
    figures: Figures = {}
    if "cost" in args.groups:
        figures |= _cost(args.quick)
    # For the pool: its processes load NumPy after this.
    one_blas_thread()
    wanted = [g for g in _CASES if g in args.groups]
    place = kept_file("diagnosis", "benchmarks/diagnosis_parts")
    with Processes(2) as pool:
        run_all = partial(run_kept, place, cases.words, pool)
        rows = _run_cases(args, wanted, partial(run_all, cases.run))
        jobs = measured.jobs(args.quick) if "measured" in args.groups else []
        named = {f"measured {' '.join(job)}": job for job in jobs}
        results = list(run_all(measured.run, named).values())
    if wanted:
        figures |= bars.case_figures(rows, args.deciding)
    if "measured" in args.groups:
        figures |= measured.measured_figures(results)
    save_rows(args, figures, cases=rows, measured=results)
    show_confusion(rows, args.full_json)
    return finish(figures)


def show_confusion(rows: Mapping[str, Sequence[Mapping]], beside: Path | None) -> None:
    """Print what each hidden effect is taken for; write it beside a results file."""
    told = [r for g in _CONFUSED for r in rows.get(g, ()) if "outcome" in r]
    cells = confusion(told)
    if not cells:
        return
    print(f"\n{'hidden':22} {'cases':>5}  said")
    for hidden, own in groupby(cells, lambda cell: cell["hidden"]):
        said = {cell["said"]: cell["cases"] for cell in own}
        words = ", ".join(f"{name} {count}" for name, count in said.items())
        print(f"{hidden:22} {sum(said.values()):5}  {words}")
    if beside:
        path = beside.with_name(f"{beside.stem}_confusion.parquet")
        pq.write_table(pa.Table.from_pylist(cells), path)


def _run_cases(
    args: argparse.Namespace, groups: Sequence[str], run_all: Callable
) -> Mapping[str, list]:
    """Run the cases of all groups, those that say sizes first."""
    seeds = seed_range(args.seeds)
    wanted = {group: cases.tasks(group, seeds, args.quick) for group in groups}
    every = [task for tasks in wanted.values() for task in tasks]
    benches, sizes = cases.benches(every), {}
    still = run_all({task.name: (task, ()) for task in benches})
    for task in benches:
        if "error" in still[task.name]:
            why = still[task.name]["error"]
            raise SystemExit(f"{task.name} failed: no sizes known. {why}")
        sizes[task.data, task.motion] = still[task.name]["minimum"]
    rows = run_all({t.name: (t, sizes.get((t.data, t.motion), ())) for t in every})
    return {group: [rows[t.name] for t in tasks] for group, tasks in wanted.items()}


def _cost(quick: bool) -> Figures:
    """Time `modelgap diagnose` on two minutes of six-joint logs at 250 Hz.

    Five logs of 20 s to fit and one held out, as CSV; peak memory is that of the
    process and of what it starts.
    """
    if quick:
        return all_missing(_COSTS, "the full run decides")
    with tempfile.TemporaryDirectory() as folder:
        *fit, held_out = _write_logs(Path(folder))
        words = ["diagnose", *fit, "--holdout", held_out, "--robot", "irb140"]
        words += ["--json", str(Path(folder) / "verdict.json")]
        done = [run_shell(words, folder) for _ in range(3)]
        ok = (Path(folder) / "verdict.json").exists()
    failed = next((each for each in done if each.code != 0 or not ok), None)
    if failed is not None:
        figures = {k: missing(bar, failed.failure) for k, bar in _COSTS.items()}
        return {name: entry | {"ok": False} for name, entry in figures.items()}
    seconds = [round(each.seconds, 2) for each in done]
    peak = round(max(each.gigabytes for each in done), 3)
    return {
        "seconds": figure(
            float(np.median(seconds)), _COSTS["seconds"], len(done), all=seconds
        ),
        "peak_gb": figure(peak, _COSTS["peak_gb"], len(done)),
    }


def _write_logs(folder: Path) -> list[str]:
    case = standard_case("stribeck", 1, joint=2, robot=load_robot("irb140"))
    logs = (*case.fit[1:], case.held_out[1])
    return [str(write_csv(folder / f"{log.id}.csv", log)) for log in logs]


if __name__ == "__main__":
    sys.exit(main())
