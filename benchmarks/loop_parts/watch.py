"""A stream is watched: how soon is a change alarmed, and how often is nothing?

    python -m benchmarks.loop_parts.watch --seeds 1:1 --keep FILE.jsonl

One case is an arm with undeclared friction. It is learnt from healthy runs of all four
families, cold and warm; then it runs on unchanged from a cold start, family after
family, in batches of a tenth of a second; then it is stopped, changed, and runs again.
Motions that taught are not watched. Finished cases are kept, so it may be cut off.
"""

import sys
from collections.abc import Sequence
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np

from benchmarks.diagnosis_parts.kept import Kept
from benchmarks.figures import ROOT, Figures, code_hash, figure, finish, one_blas_thread
from benchmarks.loop_parts.watch_arms import ROBOT, Run, log_run
from benchmarks.seeded import guarded, save_rows, seed_range, seeded_options, undecided
from flows.blind.sums import wilson
from flows.settings import cores
from flows.workers.pool import Pool
from residual.model.nominal import declared_names, prepare_logs, start_nominal
from residual.monitoring.stream.learn import learn
from residual.monitoring.stream.reference import Reference
from residual.monitoring.stream.rows import Samples
from residual.monitoring.stream.watch import State, begin, step
from residual.recording import Recording
from residual.signals.track import Filters
from sim.streams import stream
from sim.trajectories import KINDS

SEEDS = "9801:9816"  # of the deciding run
_HEALTHY = (0.0, 120.0, 300.0, 700.0, 1500.0, 3000.0)  # s: starts of healthy runs
_LONG, _RUN, _AFTER, _PAUSE = 30.0, 20.0, 8.0, 1.0  # s
_UNCHANGED = 900.0  # s of each arm; eight arms make two hours
_LOADS, _GAINS = 2, 4  # changed runs of each family and arm
LOAD_BAR, GAIN_BAR, MISSED = 2.0, 1.0, 0.05  # s of motion; share that may be later
_BATCH = 25  # samples


def figures_of(quick: bool) -> Figures:
    """Return the figures of the group."""
    if quick:
        row = watch_arm(1, quick=True)
        return undecided(_figures([row]))
    return _figures(_rows(seed_range(SEEDS), None))


def main() -> int:
    """Run the cases of any seeds."""
    parser = seeded_options(__doc__, SEEDS, ("watch",))
    args = parser.parse_args()
    one_blas_thread()
    rows = _rows(seed_range(args.seeds), args.keep)
    made = _figures(rows)
    figures = made if args.seeds == SEEDS else undecided(made)
    save_rows(args, figures, rows=rows)
    return finish(figures)


def _rows(seeds: Sequence[int], keep: Path | None) -> list[dict]:
    name = f"watch-{code_hash()}.jsonl"
    place = keep or ROOT / "store" / "benchmarks" / name
    jobs = {f"arm {seed}": seed for seed in seeds}
    with Pool(cores()) as pool, Kept(place, _words) as known:
        return list(known.run(pool, watch_arm, jobs).values())


def watch_arm(seed: int, quick: bool = False) -> dict:
    """Return what was seen of one arm."""
    return guarded({"arm": seed}, partial(_watched, seed, quick))


def _watched(seed: int, quick: bool) -> dict:
    starts = _HEALTHY[::2] if quick else _HEALTHY
    numbers = count()
    healthy = [
        log_run(Run(seed, family, next(numbers), 10.0 if quick else _LONG, start))
        for family in KINDS
        for start in starts
    ]
    reference = _learnt(healthy)
    state, false = _unchanged(seed, reference, 80.0 if quick else _UNCHANGED)
    changed = [_changed(run, reference, state) for run in _changes(seed, quick)]
    return {
        "arm": seed,
        "healthy_s": reference.hours * 3600.0,
        "unchanged_s": state.tail.heard.samples / reference.rate,
        "false": false,
        "changed": changed,
        "limits": [round(float(x), 1) for x in reference.limits],
    }


def _learnt(healthy: Sequence[Recording]) -> Reference:
    logs = prepare_logs(ROBOT, healthy, None, Filters())
    return learn(start_nominal(logs, declared_names(ROBOT, None)).model, healthy)


def _unchanged(
    seed: int, reference: Reference, seconds: float
) -> tuple[State, list[dict]]:
    """Run on from a cold start, family after family; return every alarm."""
    state, false, start = begin(reference), [], 0.0
    for number in count(1000):
        if start >= seconds:
            return state, false
        family = KINDS[number % len(KINDS)]
        run = Run(seed, family, number, _RUN, start)
        for batch in _batches(log_run(run)):
            state, alarms = step(reference, state, batch)
            false += [_said(a) | {"family": family} for a in alarms]
        start += _RUN + _PAUSE


def _changes(seed: int, quick: bool) -> list[Run]:
    rng = stream(seed, "watch/changes")
    runs = []
    for number, family in enumerate(KINDS):
        for k in range(1 if quick else _LOADS):
            at = float(rng.uniform(_UNCHANGED, 4 * _UNCHANGED))
            numbered = 2000 + 100 * number + k
            runs.append(Run(seed, family, numbered, _AFTER, at, "load"))
        joints = rng.permutation(ROBOT.dof)[: 1 if quick else _GAINS]
        for k, joint in enumerate(joints):
            at = float(rng.uniform(_UNCHANGED, 4 * _UNCHANGED))
            numbered = 3000 + 100 * number + k
            runs.append(Run(seed, family, numbered, _AFTER, at, "gain", int(joint) + 1))
    return runs


def _changed(run: Run, reference: Reference, state: State) -> dict:
    """Return the motion until a change is alarmed, None for never, and the alarm."""
    before = state.moved
    about = {"family": run.family, "change": run.change, "joint": run.joint}
    for batch in _batches(log_run(run)):
        state, alarms = step(reference, state, batch)
        if alarms:
            motion = (state.moved - before) / reference.window.row_rate
            return about | {"motion": motion} | _said(alarms[0])
    return about | {"motion": None}


def _batches(log: Recording):
    for first in range(0, len(log.t), _BATCH):
        rows = slice(first, first + _BATCH)
        yield Samples(log.t[rows], log.q[rows], log.tau[rows])


def _said(alarm) -> dict:
    said = {"quantity": alarm.quantity, "on": alarm.joint, "or_else": alarm.or_else}
    return said | {"size": alarm.size, "std": alarm.std}


def _figures(rows: Sequence[dict]) -> Figures:
    done = [row for row in rows if "changed" in row]
    hours = sum(row["unchanged_s"] for row in done) / 3600.0
    false = sum(len(row["false"]) for row in done)
    per_two = 2.0 * false / hours if hours else None
    made = {
        "watch_false_alarms": figure(per_two, 0.0, len(done), hours=hours, count=false),
        "watch_crashes": figure(len(rows) - len(done), 0, len(rows)),
    }
    for change, bar in (("load", LOAD_BAR), ("gain", GAIN_BAR)):
        seen = [c for r in done for c in r["changed"] if c["change"] == change]
        made |= _delays(change, bar, seen)
    return made


def _delays(change: str, bar: float, seen: Sequence[dict]) -> Figures:
    delays = np.array([np.inf if c["motion"] is None else c["motion"] for c in seen])
    late = int((delays > bar).sum())
    named = [c.get("quantity") == change for c in seen]
    right = [
        n and c["on"] == (c["joint"] or ROBOT.dof)
        for n, c in zip(named, seen, strict=False)
    ]
    by_joint = {
        str(j): sum(
            d > bar for d, c in zip(delays, seen, strict=False) if c["joint"] == j
        )
        for j in sorted({c["joint"] for c in seen})
    }
    count_ = max(1, len(seen))
    return {
        f"watch_{change}_late": figure(
            late / count_,
            MISSED,
            len(seen),
            interval=wilson(late, count_),
            late_by_joint=by_joint,
            what=f"alarmed later than {bar:g} s of motion, or never",
        ),
        f"watch_{change}_median": figure(_finite(np.median(delays)), None, len(seen)),
        f"watch_{change}_named": figure(sum(right), None, len(seen)),
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _words(row: dict) -> str:
    late = [c for c in row["changed"] if c["motion"] is None or c["motion"] > 2.0]
    return f"{len(row['false'])} false, {len(late)} of {len(row['changed'])} over 2 s"


if __name__ == "__main__":
    sys.exit(main())
