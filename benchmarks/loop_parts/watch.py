"""A stream is watched: how soon is a change alarmed, and how often is nothing?

    python -m benchmarks.loop_parts.watch --seeds 1:8

One case is an arm in use. It is learnt from healthy runs of all families of motion,
cold and warm; then it runs on unchanged from a cold start, family after family, in
batches of a second; then it is changed in the second of three runs, once for each of
the changes. Motions that taught are not watched. Measured arms are watched on the
days that did not teach. Finished cases are kept, so it may be cut off.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count

import numpy as np

from benchmarks.changes_parts import arms, real
from benchmarks.changes_parts.case import Case
from benchmarks.harness import cases as harness
from benchmarks.harness.figures import (
    Figures,
    figure,
    finish,
    one_blas_thread,
    undecided,
)
from benchmarks.measured_parts.arms import UR10E, absent
from benchmarks.measured_parts.arms import robot_of as measured_robot
from benchmarks.synthetic.motions import FAMILIES, make_motion
from flows.blind.score import wilson
from flows.settings import cores
from flows.workers.pool import Pool
from residual.model.nominal import declared_names, prepare_logs, start_nominal
from residual.monitoring.learn import learn
from residual.monitoring.reference import Reference
from residual.monitoring.rows import Samples
from residual.monitoring.watch import State, begin, step
from residual.recording import Recording
from residual.robot.dynamics import reach
from residual.robot.robot import Robot
from residual.signals.track import Filters
from sim.engine.records import Hidden, stream
from sim.plant.background import logged
from sim.plant.sensors import encoder, torque_noise
from sim.plant.sizes import sizes, usual_limits
from sim.quasi_static import Plant, background_of, true_friction, true_torque

RATE = arms.RATE
LOAD, GAIN, SMALL_GAIN, FRICTION = "load", "gain", "small_gain", "friction"
CHANGES = (LOAD, GAIN, SMALL_GAIN, FRICTION)
_BACKGROUNDS = ("workshop", "worn")
_ARMS = (*arms.SIX, arms.SEVEN, arms.OTHER_SEVEN)
# An arm carries what takes so much of the second joint's torque at full reach: of the
# built-in one that are the 6 kg of its maker.
_RATED = 0.44
_GRAVITY = 9.81  # m/s^2
_LEAST_LOAD, _REACH = 1.0, 0.1  # kg; m from the flange to its centre
_GAIN = {GAIN: 0.3, SMALL_GAIN: 0.1}
_MORE = 0.5  # of a joint's friction
_MOVES = 0.05  # rad/s
_TAUGHT, _WATCHED = 3, 2  # days of the measured arm


@dataclass(frozen=True, slots=True)
class Run:
    """One run of an arm."""

    arm: int  # seed of the arm
    family: str  # kind of motion
    number: int  # makes the motion and the noise
    seconds: float  # length [s]
    start: float  # time on the clock of the arm [s]
    worked: float  # usual work before it [s]
    change: str = ""  # one of CHANGES, or ""
    joint: int = 0  # joint that changes, from 1; 0 for a load
    draw: int = 0  # draws the change; the same in runs with the same one
    onset: float = 0.0  # from when on it is changed, since the run began [s]


def robot_of(arm: int) -> Robot:
    return arms.robot_of(_ARMS[arm % len(_ARMS)])


def log_run(run: Run) -> Recording:
    before = _recorded(run, ())
    if not run.change:
        return before
    after = _recorded(run, _effects(run))
    changed = (before.t - run.start >= run.onset)[:, None]
    return replace(
        before,
        q=np.where(changed, after.q, before.q),
        tau=np.where(changed, after.tau, before.tau),
    )


def share(run: Run) -> float:
    """Return the torque of a change over that of its joint, both rms in motion."""
    before, after = _recorded(run, ()), _recorded(run, _effects(run))
    j = run.joint - 1
    speed = np.gradient(before.q[:, j], before.t)
    rows = (np.abs(speed) > _MOVES) & (before.t - run.start >= run.onset)
    change = (after.tau - before.tau)[rows, j]
    return float(np.sqrt(np.mean(change**2) / np.mean(before.tau[rows, j] ** 2)))


def _plant(run: Run, effects: tuple[Hidden, ...]) -> Plant:
    word = _BACKGROUNDS[run.arm // len(_ARMS) % 2]
    return Plant(robot_of(run.arm), effects, run.arm, word)


def _recorded(run: Run, effects: tuple[Hidden, ...]) -> Recording:
    """Return a log that is changed from its begin on, or not at all."""
    plant, label = _plant(run, effects), f"watch/{run.arm}/{run.number}"
    limits, rng = usual_limits(plant.robot), stream(run.number, label)
    motion = make_motion(run.family, limits, run.seconds, RATE, rng)
    torque = true_torque(plant, motion, label, run.start, True, run.worked)
    rng = stream(run.number, f"{label}/torque")
    tau = torque.tau + torque_noise(len(motion.t), sizes(plant.robot).torque, RATE, rng)
    q = encoder(torque.reading, stream(run.number, f"{label}/encoder"))
    tau = logged(background_of(plant), tau, RATE)
    return Recording(label, plant.robot.name, run.start + motion.t, q, tau)


def _effects(run: Run) -> tuple[Hidden, ...]:
    robot, rng = robot_of(run.arm), stream(run.draw, f"watch/{run.arm}/change")
    if run.change == LOAD:
        rated = _RATED * sizes(robot).torque[1] / _GRAVITY / reach(robot.model)
        way = rng.normal(size=3)
        x, y, z = _REACH * way / np.linalg.norm(way)
        held = {"mass": max(_LEAST_LOAD, 0.1 * rated)}
        held |= {"com_x": x, "com_y": y, "com_z": abs(z)}
        return (Hidden("payload", (robot.dof,), held),)
    if run.change == FRICTION:
        own, j = true_friction(_plant(run, ())), run.joint - 1
        return (
            Hidden("coulomb", (run.joint,), {"level": _MORE * own.coulomb[j]}),
            Hidden("viscous", (run.joint,), {"coefficient": _MORE * own.viscous[j]}),
        )
    gain = float(rng.choice([-1.0, 1.0])) * _GAIN[run.change]
    return (Hidden("torque_gain", (run.joint,), {"gain": gain}),)


def days() -> Iterator[tuple[Robot, list[Recording], list[Recording]]]:
    """Yield a measured robot, days that teach and days that are watched."""
    if absent(UR10E):
        return
    robot = measured_robot(UR10E)
    for arm, first, second in real.unchanged_epochs():
        if (arm, len(first), len(second)) != (UR10E, _TAUGHT, _WATCHED):
            continue
        case = Case("", 0, 0, arm, "", 0, 0, (0.0, 0.0), first, second)
        yield robot, list(real.read(case, first)), list(real.read(case, second))


SEEDS = "125101:125116"  # of the deciding run: 9 h unchanged
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


def main() -> int:
    args = harness.read_options(__doc__, SEEDS, ("watch",))
    one_blas_thread()
    if args.quick:
        rows = [watch_arm(1, quick=True)]
    else:
        jobs = {"days": DAYS} | {f"arm {s}": s for s in harness.seed_range(args.seeds)}
        place = harness.kept_file("watch", "benchmarks/loop_parts/watch.py")
        with Pool(cores()) as pool:
            rows = list(harness.run_kept(place, _words, pool, watch_arm, jobs).values())
    made = _figures(rows)
    figures = made if args.whole else undecided(made)
    harness.save_rows(args, figures, rows=rows)
    return finish(figures)


def watch_arm(seed: int, quick: bool = False) -> dict:
    """Return what was seen of one arm; of the measured one on its days."""
    about = {"arm": seed}
    return harness.guarded(
        about, _of_days if seed == DAYS else partial(_watched, seed, quick)
    )


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
        for k, family in enumerate(FAMILIES):
            now = start + k * (seconds + _PAUSE)
            runs.append(Run(seed, family, next(number), seconds, now, now))
    return runs


def learnt(robot: Robot, healthy: Sequence[Recording]) -> Reference:
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
        family = FAMILIES[number % len(FAMILIES)]
        run = Run(seed, family, 1000 + number, _RUN, _DAY + worked, worked)
        for batch in _batches(log_run(run)):
            state, alarms = step(reference, state, batch)
            false += [_said(a) | {"family": family} for a in alarms]
        worked += _RUN + _PAUSE


def changes(seed: int, each: int) -> list[tuple[Run, ...]]:
    """Return runs of an arm, by threes; the change begins in the second and stays."""
    rng, out, dof = stream(seed, "watch/changes"), [], robot_of(seed).dof
    kinds = [(kind, family) for kind in CHANGES for family in FAMILIES]
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
            begun = one.change and batch.t[0] >= one.start + _ONSET - 1e-6
            if begun and before is None:
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
            every = Samples(log.t, log.q, log.tau)
            _, alarms = step(reference, begin(reference), every)
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
    joints = np.array([c["joint"] for c in seen])
    by_joint = {
        str(j): int((delays[joints == j] > WITHIN[kind]).sum())
        for j in sorted(set(joints.tolist()))
    }
    many = max(1, len(seen))
    median = float(np.median(delays)) if len(delays) else np.inf
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
        f"watch_{kind}_median": figure(
            median if np.isfinite(median) else None, None, len(seen)
        ),
        f"watch_{kind}_named": figure(named, None, len(seen)),
    }


def _words(row: dict) -> str:
    if "days_s" in row:
        return f"{len(row['days_false'])} false in {row['days_s']:.0f} s of other days"
    known = [(c["motion"], WITHIN[c["change"]]) for c in row["changed"]]
    late = [motion for motion, most in known if motion is None or motion > most]
    return f"{len(row['false'])} false, {len(late)} of {len(row['changed'])} late"


if __name__ == "__main__":
    sys.exit(main())
