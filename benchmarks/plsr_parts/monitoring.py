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

from benchmarks.harness.figures import Figures, figure, missing, partial
from benchmarks.harness.rates import wilson
from residual.errors import InputError
from residual.identification.identify import identify
from residual.monitoring.monitor import Alarm, calibrate
from residual.recording import Recording
from residual.robot.robot import load_robot
from sim.engine.records import (
    PlantEffect,
    PlantSpec,
    Rates,
    Reference,
    TrajectorySpec,
    stream,
)
from sim.experiment import log_of
from sim.plant.sizes import sizes
from sim.plant.stepping import drive
from sim.trajectories import KINDS, make_reference

ROBOT = load_robot("irb140")
_AFTER = 3.5  # s that a run goes on after the onset
_MOVES = 1e-2  # rad: how far a joint is asked to move in the 0.1 s after it froze
_CYCLE = 5.0  # s at least: welding in less often breaks a limit of the arm


@dataclass(frozen=True, slots=True)
class Case:
    """One run: which arm, family and number, and the fault in it, if any."""

    arm: int
    family: str
    number: int
    duration: float
    fault: str = ""


def good_run(case: Case) -> Recording:
    """Make the log of a case."""
    return run_of(case)[2]


def run_of(case: Case) -> tuple[int, float, Recording]:
    """Return the joint with the fault, its onset on the log's clock, and the log."""
    rng = stream(case.number, f"monitoring/{case.arm}/{case.family}/{case.fault}")
    motion, start = _motion(case, rng), float(rng.uniform(0, 600))
    if not case.fault:
        return 0, np.inf, _drive(case.arm, motion, (), start)
    joint, onset = _place(case, motion, rng)
    steps = round((onset + _AFTER) * 1000)
    effect = _effect(case.fault, joint, onset, float(rng.choice([-1.0, 1.0])))
    log = _drive(case.arm, _cut(motion, steps), (effect,), start)
    return joint, start + onset, log


def _motion(case: Case, rng: np.random.Generator) -> Reference:
    most = int(case.duration // _CYCLE)
    periods = int(rng.integers(min(3, most), most + 1))
    while True:  # some draws break a limit of the arm
        spec = TrajectorySpec(
            case.family, case.duration, periods, int(rng.integers(2**31))
        )
        try:
            return make_reference(ROBOT, spec, Rates().control, optimised=False)
        except InputError:
            continue


def _place(case: Case, motion: Reference, rng: np.random.Generator):
    """Draw joint and onset: where the program repeats, and the fault can show."""
    latest = case.duration - 1.5
    first = min(2 * motion.period + 0.5, latest - 1.0)
    while True:
        joint = int(rng.integers(1, ROBOT.dof + 1))
        onset = float(rng.uniform(first, latest))
        k = round(onset * 1000)
        way = np.ptp(motion.q[k : k + 100, joint - 1])
        if case.fault != "frozen" or way > _MOVES:
            return joint, round(onset, 3)


def _effect(fault: str, joint: int, onset: float, sign: float) -> PlantEffect:
    span = sizes(ROBOT).torque[joint - 1]
    name, parameters = {
        "frozen": ("x_fault_frozen", ()),
        "jump": ("encoder_offset", (("angle", sign * np.deg2rad(0.5)),)),
        "spikes": ("x_fault_torque_spikes", (("size", sign * 0.5 * span),)),
        "torque bias": ("x_fault_torque_bias", (("torque", sign * 0.1 * span),)),
        "gain drop": ("torque_gain", (("gain", -0.3),)),
        "gain drop of the log": ("x_fault_torque_gain", (("gain", -0.3),)),
        "drift": ("x_fault_drift", (("rate", sign * np.deg2rad(0.2)),)),
    }[fault]
    return PlantEffect(name, (joint,), parameters, onset)


def _cut(motion: Reference, steps: int) -> Reference:
    arrays = {name: getattr(motion, name)[:steps] for name in ("t", "q", "qd", "qdd")}
    return replace(motion, **arrays)


def _drive(arm: int, motion: Reference, effects: tuple, start: float) -> Recording:
    """Drive an arm and log it; its twin, which takes as long, is not needed."""
    plant = PlantSpec(effects, seed=arm)
    return log_of(drive(ROBOT, motion, plant, start), motion, plant, Rates(), start)


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
_NAMES = {"torque bias": "bias", "gain drop": "lost scale"} | {
    "gain drop of the log": "lost scale"
}
_PER_HOUR = 1.0


@dataclass(frozen=True, slots=True)
class Plan:
    """How much is measured.

    Attributes:
        good: Runs to calibrate on, of each family and arm.
        healthy: Runs without a fault, of each family and arm.
        faulty: Runs of each fault, family and arm.
        duration: Length of a run [s].
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
        joint: Joint with the fault, from 1; 0 for none.
        onset: When it began, on the clock of the log [s].
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
        fault = self.case.fault
        return self.named and self.first.fault == _NAMES.get(fault, fault)


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
    monitor = calibrate(identify(ROBOT, good).model, good, _PER_HOUR)
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
