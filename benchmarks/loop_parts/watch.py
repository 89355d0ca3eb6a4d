"""A stream is watched: how soon is a change alarmed, and how often is nothing?

    python -m benchmarks.loop_parts.watch --seeds 1:8 --keep FILE.jsonl

One case is an arm in use. It is learnt from healthy runs of all families of motion,
cold and warm; then it runs on unchanged from a cold start, family after family, in
batches of a second; then it is changed in the second of three runs, once for each of
the changes. Motions that taught are not watched. Measured arms are watched on the
days that did not teach. Finished cases are kept, so it may be cut off.
"""

import sys
from collections.abc import Sequence
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np

from benchmarks.diagnosis_parts.kept import Kept
from benchmarks.figures import ROOT, Figures, code_hash, figure, finish, one_blas_thread
from benchmarks.loop_parts.watch_arms import (
    CHANGES,
    FRICTION,
    GAIN,
    LOAD,
    RATE,
    SMALL_GAIN,
    Run,
    days,
    families,
    log_run,
    robot_of,
    share,
)
from benchmarks.seeded import guarded, save_rows, seed_range, seeded_options, undecided
from flows.blind.sums import wilson
from flows.settings import cores
from flows.workers.pool import Pool
from residual.model.nominal import declared_names, prepare_logs, start_nominal
from residual.monitoring.learn import learn
from residual.monitoring.reference import Reference
from residual.monitoring.rows import Samples
from residual.monitoring.watch import State, begin, step
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.track import Filters
from sim.records import stream

SEEDS = "9801:9840"  # of the deciding run: 22 h unchanged
DAYS = 0  # in place of a seed: the measured arm
_HEALTHY = (0.0, 240.0, 480.0, 900.0, 1600.0, 3000.0)  # s of work before healthy runs
_LONG, _RUN, _PAUSE = 30.0, 20.0, 1.0  # s
_DAY = 86400.0  # s from the healthy runs to the watched ones
_UNCHANGED = 900.0  # s of each arm
_ONSET = 5.0  # s: when a change begins in the second of three runs
_EACH = 2  # changed runs of each family and kind
_SHARE = 0.05  # of a joint's torque: friction that is less is not asked for
# Motion within which a change is to be seen [s], and share that is to be.
WITHIN = {LOAD: 5.0, GAIN: 5.0, SMALL_GAIN: 20.0, FRICTION: 20.0}
SEEN = {LOAD: 0.95, GAIN: 0.95, SMALL_GAIN: 0.90, FRICTION: 0.90}
NAMED, FALSE = 0.85, 1.0  # share; in eight hours
_BATCH = round(RATE)  # samples


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
    jobs = {"days": DAYS} | {f"arm {seed}": seed for seed in seeds}
    with Pool(cores()) as pool, Kept(place, _words) as known:
        return list(known.run(pool, watch_arm, jobs).values())


def watch_arm(seed: int, quick: bool = False) -> dict:
    """Return what was seen of one arm; of the measured one on its days."""
    about = {"arm": seed}
    return guarded(about, _of_days if seed == DAYS else partial(_watched, seed, quick))


def _watched(seed: int, quick: bool) -> dict:
    long = 10.0 if quick else _LONG
    healthy = [log_run(run) for run in healthy_runs(seed, long)]
    reference = learnt(robot_of(seed), healthy)
    state, false = _unchanged(seed, reference, 80.0 if quick else _UNCHANGED)
    runs = changes(seed, 1 if quick else _EACH)
    return {
        "arm": seed,
        "healthy_s": reference.hours * 3600.0,
        "unchanged_s": state.tail.heard.samples / reference.rate,
        "false": false,
        "changed": [_changed(run, reference, state) for run in runs],
        "limits": [round(float(x), 1) for x in reference.limits],
        "unrest": reference.usual.unrest.max(axis=1).round(2).tolist(),
    }


def healthy_runs(seed: int, seconds: float) -> list[Run]:
    """Return runs of all families after each other, at several times of a day."""
    runs, number = [], count()
    for start in _HEALTHY:
        for k, family in enumerate(families()):
            now = start + k * (seconds + _PAUSE)
            runs.append(Run(seed, family, next(number), seconds, now, now))
    return runs


def learnt(robot: Robot, healthy: Sequence[Recording]) -> Reference:
    """Return what healthy runs teach of a robot."""
    logs = prepare_logs(robot, healthy, None, Filters())
    return learn(start_nominal(logs, declared_names(robot, None)).model, healthy)


def _unchanged(
    seed: int, reference: Reference, seconds: float
) -> tuple[State, list[dict]]:
    """Run on from a cold start, family after family; return every alarm."""
    state, false, worked = begin(reference), [], 0.0
    for number in count(1000):
        if worked >= seconds:
            return state, false
        family = families()[number % len(families())]
        run = Run(seed, family, 1000 + number, _RUN, _DAY + worked, worked)
        for batch in _batches(log_run(run)):
            state, alarms = step(reference, state, batch)
            false += [_said(a) | {"family": family} for a in alarms]
        worked += _RUN + _PAUSE


def changes(seed: int, each: int) -> list[tuple[Run, ...]]:
    """Return runs of an arm, three after each other, at other times of the same day.

    The change begins in the second and stays.
    """
    rng, out, dof = stream(seed, "watch/changes"), [], robot_of(seed).dof
    kinds = [(kind, family) for kind in CHANGES for family in families()]
    for i, (kind, family) in enumerate(kinds * each):
        worked = float(rng.uniform(_UNCHANGED, 4 * _UNCHANGED))
        joint = 0 if kind == LOAD else int(rng.integers(dof)) + 1
        runs = []
        for k, (change, onset) in enumerate((("", 0.0), (kind, _ONSET), (kind, 0.0))):
            number, past = 2000 + 10 * i + k, worked + k * (_LONG + _PAUSE)
            about = (seed, family, number, _LONG, _DAY + past, past)
            runs.append(Run(*about, change, joint, i, onset))
        out.append(tuple(runs))
    return out


def _changed(runs: Sequence[Run], reference: Reference, state: State) -> dict:
    """Return the motion until a change is alarmed, None for never, and the alarm."""
    run = runs[1]
    about = {"family": run.family, "change": run.change, "joint": run.joint}
    if run.change == FRICTION:
        about |= {"share": share(run)}
    early, before = [], None
    about |= {"before_s": _LONG + _ONSET, "early": early, "motion": None}
    for one in runs:
        log = log_run(one)
        for batch in _batches(log):
            if (
                one.change
                and before is None
                and batch.t[0] >= one.start + _ONSET - 1e-6
            ):
                before = state.moved
            state, alarms = step(reference, state, batch)
            if before is None:
                early += [_said(a) for a in alarms]
            elif alarms:
                behind = log.t[(log.t > alarms[0].time) & (log.t <= batch.t[-1])]
                motion = (state.moved - before) / reference.window.row_rate
                motion -= len(behind) / RATE
                return about | {"motion": motion} | _said(alarms[0])
    return about


def _batches(log: Recording):
    for first in range(0, len(log.t), _BATCH):
        rows = slice(first, first + _BATCH)
        yield Samples(log.t[rows], log.q[rows], log.tau[rows])


def _said(alarm) -> dict:
    said = {"quantity": alarm.quantity, "on": alarm.joint, "or_else": alarm.or_else}
    more = {"score": alarm.score, "window": alarm.motion}
    return said | {"size": alarm.size, "std": alarm.std} | more


def _of_days() -> dict:
    false, seconds = [], 0.0
    for robot, taught, watched in days():
        reference = learnt(robot, taught)
        for log in watched:
            _, alarms = step(
                reference, begin(reference), Samples(log.t, log.q, log.tau)
            )
            about = {"taught": [r.id for r in taught], "day": log.id}
            false += [_said(a) | about for a in alarms]
            seconds += log.duration
    return {"arm": DAYS, "days_s": seconds, "days_false": false}


def _figures(rows: Sequence[dict]) -> Figures:
    done = [row for row in rows if "changed" in row]
    every = [c for row in done for c in row["changed"]]
    hours = sum(row["unchanged_s"] for row in done) / 3600.0
    hours += sum(c["before_s"] for c in every) / 3600.0
    false = sum(len(row["false"]) for row in done) + sum(len(c["early"]) for c in every)
    per_shift = 8.0 * false / hours if hours else None
    crashed = [row for row in rows if not {"changed", "days_s"} & set(row)]
    made = {
        "watch_false_alarms": figure(
            per_shift, FALSE, len(done), hours=hours, count=false
        ),
        "watch_crashes": figure(len(crashed), 0, len(rows)),
    }
    measured = [row for row in rows if "days_s" in row and row["days_s"] > 0]
    if measured:
        alarms = sum(len(row["days_false"]) for row in measured)
        seconds = sum(row["days_s"] for row in measured)
        made["watch_other_days"] = figure(alarms, 0, len(measured), seconds=seconds)
    asked = [c for c in every if c.get("share", 1.0) >= _SHARE]
    for kind in CHANGES:
        made |= _delays(kind, [c for c in asked if c["change"] == kind])
    seen = [c for c in asked if c["motion"] is not None]
    wrong = sum(not _right(c) for c in seen)
    made["watch_misnamed"] = figure(
        wrong / max(1, len(seen)),
        1 - NAMED,
        len(seen),
        interval=wilson(wrong, max(1, len(seen))),
        what="first name is another quantity or joint",
    )
    return made


def _right(c: dict) -> bool:
    """Whether the first name of an alarm is that of the change."""
    wanted = GAIN if c["change"] == SMALL_GAIN else c["change"]
    return c["quantity"] == wanted and (wanted == LOAD or c["on"] == c["joint"])


def _delays(kind: str, seen: Sequence[dict]) -> Figures:
    delays = np.array([np.inf if c["motion"] is None else c["motion"] for c in seen])
    late = int((delays > WITHIN[kind]).sum())
    by_joint = {
        str(j): sum(
            bool(d > WITHIN[kind])
            for d, c in zip(delays, seen, strict=True)
            if c["joint"] == j
        )
        for j in sorted({c["joint"] for c in seen})
    }
    many = max(1, len(seen))
    named = sum(c["motion"] is not None and _right(c) for c in seen)
    return {
        f"watch_{kind}_late": figure(
            late / many,
            1 - SEEN[kind],
            len(seen),
            interval=wilson(late, many),
            late_by_joint=by_joint,
            what=f"alarmed later than {WITHIN[kind]:g} s of motion, or never",
        ),
        f"watch_{kind}_median": figure(_finite(delays), None, len(seen)),
        f"watch_{kind}_named": figure(named, None, len(seen)),
    }


def _finite(delays: np.ndarray) -> float | None:
    value = float(np.median(delays)) if len(delays) else np.inf
    return value if np.isfinite(value) else None


def _words(row: dict) -> str:
    if "days_s" in row:
        return f"{len(row['days_false'])} false in {row['days_s']:.0f} s of other days"
    late = [
        c
        for c in row["changed"]
        if c["motion"] is None or c["motion"] > WITHIN[c["change"]]
    ]
    return f"{len(row['false'])} false, {len(late)} of {len(row['changed'])} late"


if __name__ == "__main__":
    sys.exit(main())
