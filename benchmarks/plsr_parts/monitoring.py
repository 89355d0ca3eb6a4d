"""Sensors that fail on the plant: found, how soon, named; and alarms without a fault.

One monitor per arm, calibrated on runs of other motions than those it watches. Delays
are from the onset to the alarm, on the clock of the log; a spike's from each run's
first. Frozen encoders begin while the joint is asked to move: a joint that stands reads
the same either way.
"""

import multiprocessing
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.figures import Figures, figure, missing, partial
from benchmarks.plsr_parts.monitor_runs import ROBOT, Case, good_run, run_of
from flows.blind.sums import wilson
from residual.model.nominal import declared_names, prepare_logs, start_nominal
from residual.monitoring.monitor import Alarm, calibrate
from residual.signals.track import Filters
from sim.trajectories import KINDS

# Within how many seconds each fault is to be found; None: told, without a bar.
_AT_ONCE = 0.1
FAULTS = {
    "frozen": _AT_ONCE,
    "jump": _AT_ONCE,
    "spikes": _AT_ONCE,
    "torque bias": 1.0,
    "gain drop": 1.0,
    "gain drop of the log": None,
    "drift": None,
}
_SENSOR = {"frozen": "encoder", "jump": "encoder", "drift": "encoder"}
_PER_HOUR = 1.0


@dataclass(frozen=True, slots=True)
class Plan:
    """How much is measured.

    Attributes:
        arms: Seeds of the arms.
        good: Runs to calibrate on, of each family and arm.
        healthy: Runs without a fault, of each family and arm.
        faulty: Runs of each fault, family and arm.
        duration: Length of a run [s].
        families: Kinds of motion.
        faults: What fails.
    """

    arms: tuple[int, ...]
    good: int
    healthy: int
    faulty: int
    duration: float
    families: tuple[str, ...] = KINDS
    faults: tuple[str, ...] = tuple(FAULTS)

    @property
    def hours(self) -> float:
        """Length of all healthy runs [h]."""
        runs = len(self.arms) * len(self.families) * self.healthy
        return runs * self.duration / 3600.0


_BARRED = tuple(fault for fault, bar in FAULTS.items() if bar)
QUICK = Plan((41,), 6, 2, 1, 10.0, ("fourier", "move_stop_move"), _BARRED)
FULL = Plan((41, 42, 43), 4, 15, 3, 20.0)


@dataclass(frozen=True, slots=True)
class Seen:
    """What a monitor said of one run.

    Attributes:
        case: The run.
        joint: Joint with the fault, from 1; 0 for none.
        onset: When it began, on the clock of the log [s].
        alarms: All alarms.
    """

    case: Case
    joint: int
    onset: float
    alarms: tuple[Alarm, ...]

    @property
    def false(self) -> int:
        """Alarms where there was no fault."""
        return sum(self.joint == 0 or a.time < self.onset for a in self.alarms)

    @property
    def first(self) -> Alarm | None:
        """The first alarm from the onset on."""
        return next((a for a in self.alarms if a.time >= self.onset), None)

    @property
    def delay(self) -> float:
        """From onset to alarm [s]; infinite where there was none."""
        return self.first.time - self.onset if self.first else float("inf")

    @property
    def named(self) -> bool:
        """Whether joint and sensor are right."""
        sensor, alarm = _SENSOR.get(self.case.fault, "torque"), self.first
        return alarm is not None and (alarm.joint, alarm.sensor) == (self.joint, sensor)

    @property
    def right(self) -> bool:
        """Whether the kind of fault is right too."""
        return self.named and self.case.fault.startswith(self.first.fault)


def monitoring_figures(quick: bool) -> Figures:
    """Measure delays, names and false alarms."""
    plan = QUICK if quick else FULL
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        seen = [one for arm in plan.arms for one in watch_arm(arm, plan, pool)]
    return figures_of(seen, plan, quick)


def watch_arm(arm: int, plan: Plan, pool: Executor) -> list[Seen]:
    """Calibrate on one arm, and watch its other runs."""
    cases = _cases(arm, plan, plan.healthy, 1000)
    cases += [
        replace(case, fault=fault, number=case.number + 100 * i)
        for i, fault in enumerate(plan.faults)
        for case in _cases(arm, plan, plan.faulty, 2000)
    ]
    good = list(pool.map(good_run, _cases(arm, plan, plan.good, 0)))
    logs = prepare_logs(ROBOT, good, None, Filters())
    model = start_nominal(logs, declared_names(ROBOT, None)).model
    monitor = calibrate(model, good, _PER_HOUR)
    return [
        Seen(case, joint, onset, monitor.watch(log))
        for case, (joint, onset, log) in zip(
            cases, pool.map(run_of, cases), strict=True
        )
    ]


def figures_of(seen: list[Seen], plan: Plan, quick: bool) -> Figures:
    """Return the figures of all runs."""
    why = "too few runs to confirm"
    figures: Figures = {}
    for fault in plan.faults:
        bar = FAULTS[fault]
        entry = _delay(fault, bar, [s for s in seen if s.case.fault == fault])
        name = f"monitor_delay_{fault.replace(' ', '_')}"
        if quick and bar:
            entry = partial(entry, why)
            if bar > _AT_ONCE:  # one late run of two refutes no 95 % quantile
                entry["ok"] = None
        figures[name] = entry
    judged = [s for s in seen if FAULTS.get(s.case.fault)]
    wrong = sum(not s.named for s in judged)
    other = sum(not s.right for s in judged)
    entry = figure(
        wrong / len(judged),
        0.2,
        len(judged),
        interval=wilson(wrong, len(judged)),
        share_with_another_fault=other / len(judged),
        what="share whose first alarm has another joint or sensor",
    )
    figures["monitor_channel_wrong"] = partial(entry, why) if quick else entry
    return figures | _false_alarms(seen, plan, quick)


def _delay(fault: str, bar: float | None, seen: list[Seen]) -> dict:
    """Return the delay of one fault: the largest, or what 95 % do not exceed.

    A jump, a spike, a frozen joint that moves are there at once, so every one counts.
    A gain cannot be seen before there is torque, nor a bias while friction at
    standstill hides it: there a few may be late, and are counted beside it.
    """
    delays, quick = np.array([s.delay for s in seen]), bar == _AT_ONCE
    limit, share = bar or 1.0, 1.0 if quick else 0.95
    late = int((delays > limit).sum())
    value = float(np.quantile(delays, share, method="higher"))
    told = value if np.isfinite(value) else None
    entry = figure(
        told,
        bar,
        len(seen),
        median=_finite(np.median(delays)),
        largest=_finite(delays.max()),
        late=late,
        in_time_interval=wilson(len(seen) - late, len(seen)),
        channel_named=float(np.mean([s.named for s in seen])),
        fault_named=float(np.mean([s.right for s in seen])),
        what=f"{'largest' if quick else '95 % quantile of'} delay [s]; late is over "
        f"{limit:g} s",
    )
    if bar and told is None:
        missed = int((~np.isfinite(delays)).sum())
        entry |= {"ok": False, "why": f"{missed} of {len(seen)} not found"}
    return entry


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _false_alarms(seen: list[Seen], plan: Plan, quick: bool) -> Figures:
    healthy = [s for s in seen if not s.case.fault]
    count = sum(s.false for s in healthy)
    before = sum(s.false for s in seen if s.case.fault)
    name = "monitor_false_alarms_per_hour"
    if quick:
        told = f"{count} in {60 * plan.hours:.2g} min; needs an hour"
        return {name: missing(1.0, told)}
    entry = figure(
        count / plan.hours,
        1.0,
        len(healthy),
        hours=plan.hours,
        before_onsets_of_faulty_runs=before,
    )
    return {name: entry}


def _cases(arm: int, plan: Plan, count: int, first: int) -> list[Case]:
    return [
        Case(arm, family, first + i, plan.duration)
        for family in plan.families
        for i in range(count)
    ]
