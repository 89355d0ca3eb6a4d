"""Faults of sensors on the simulated arm: how many are found in time, and named.

One monitor per arm, calibrated on healthy runs. Delays are from the onset to the first
alarm on the clock of the log. Frozen encoders begin while the joint is asked to move.
"""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.harness.figures import Figures, figure
from benchmarks.harness.rates import at_least, at_most, rate
from residual.errors import InputError
from residual.identification.identify import identify
from residual.monitoring.monitor import calibrate_monitor
from residual.recording import Recording
from residual.robot.robot import load_robot
from sim.engine.plant_records import PlantEffect, PlantSpec, SampleRates, TrajectorySpec
from sim.engine.plant_records import create_random_stream as make_rng
from sim.experiment import record_plant_log
from sim.plant.closed_loop import build_and_simulate
from sim.plant.typical_sizes import estimate_typical_sizes
from sim.trajectories import plan_reference_motion as plan_motion

ROBOT = load_robot("irb140")
# Effect, its parameters on a joint of a torque range, and when an alarm is in time [s].
FAULTS = {
    "frozen": ("x_fault_frozen", lambda span: {}, 0.1),
    "jump": ("encoder_offset", lambda span: {"angle": np.deg2rad(0.5)}, 0.1),
    "spikes": ("x_fault_torque_spikes", lambda span: {"size": 0.5 * span}, 0.1),
    "torque_bias": ("x_fault_torque_bias", lambda span: {"torque": 0.1 * span}, 1.0),
    "gain_drop": ("torque_gain", lambda span: {"gain": -0.3}, 1.0),
}
ENCODERS = ("frozen", "jump")
FAMILIES = ("fourier", "cyclic", "move_stop_move")
_DURATION, _MOVES = 20.0, 1e-2  # s; rad in the 0.1 s after the onset


@dataclass(frozen=True, slots=True)
class Case:
    """One run: an arm, a motion family, and the fault in it, if any."""

    arm: int
    family: str
    number: int
    fault: str = ""


def sensor_figures(quick: bool) -> Figures:
    """Measure shares found in time and named, and false alarms per hour."""
    arms = (61,) if quick else (61, 62, 63)
    healthy, faulty = (2, 1) if quick else (5, 3)  # of each family, and of each fault
    context = multiprocessing.get_context("spawn")
    rows, alarms, hours = [], 0, 0.0
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        for arm in arms:
            good = [Case(arm, f, i) for f in FAMILIES for i in range(4)]
            still = [Case(arm, f, 1000 + i) for f in FAMILIES for i in range(healthy)]
            bad = [
                Case(arm, f, 2000 + 100 * k + i, fault)
                for k, fault in enumerate(FAULTS)
                for f in FAMILIES
                for i in range(faulty)
            ]
            logs = [log for _, _, log in pool.map(record, good)]
            monitor = calibrate_monitor(identify(ROBOT, logs).model, logs, 1.0)
            for _, _, log in pool.map(record, still):
                alarms += len(monitor.watch(log))
                hours += _DURATION / 3600
            for case, (joint, onset, log) in zip(bad, pool.map(record, bad), strict=True):
                found = monitor.watch(log)
                alarms += sum(a.time < onset for a in found)
                hours += (onset - log.t[0]) / 3600
                first = next((a for a in found if a.time >= onset), None)
                sensor = "encoder" if case.fault in ENCODERS else "torque"
                limit = FAULTS[case.fault][2]
                in_time = first is not None and first.time - onset <= limit
                named = first and (first.joint, first.sensor) == (joint, sensor)
                rows.append((case.fault, in_time, bool(named)))
    figures = {
        f"monitor_{fault}_in_time": at_least(rate(row[1] for row in rows if row[0] == fault), 0.95)
        for fault in FAULTS
    }
    named = rate(row[2] for row in rows)
    figures["monitor_channel_named"] = at_least(named, 0.8)
    hourly = figure(alarms / hours, None, round(hours * 3600 / _DURATION), alarms=alarms)
    figures["monitor_false_alarms_per_hour"] = at_most(hourly, 1.0)
    return figures


def record(case: Case) -> tuple[int, float, Recording]:
    """Return joint (0 for none), onset on the clock of the log [s], and the log."""
    rng = make_rng(case.number, f"monitoring/{case.arm}/{case.family}/{case.fault}")
    while True:  # some draws break a limit of the arm
        spec = TrajectorySpec(case.family, _DURATION, 3, int(rng.integers(2**31)))
        try:
            motion = plan_motion(ROBOT, spec, SampleRates().control, optimised=False)
            break
        except InputError:
            continue
    start, joint, onset, effects = float(rng.uniform(0, 600)), 0, np.inf, ()
    if case.fault:
        first, latest = _DURATION - 8.0, _DURATION - 4.0
        moves = False
        while not moves:
            joint = int(rng.integers(1, ROBOT.dof + 1))
            onset = round(float(rng.uniform(first, latest)), 3)
            k = round(onset * SampleRates().control)
            moves = np.ptp(motion.q[k : k + 100, joint - 1]) > _MOVES
            moves = moves or case.fault != "frozen"
        name, parameters, _ = FAULTS[case.fault]
        sign = float(rng.choice([-1.0, 1.0])) if name != "torque_gain" else 1.0
        values = parameters(estimate_typical_sizes(ROBOT).torque[joint - 1]).items()
        scaled = tuple((key, sign * float(value)) for key, value in values)
        effects = (PlantEffect(name, (joint,), scaled, onset),)
    plant = PlantSpec(effects, seed=case.arm)
    log = record_plant_log(
        build_and_simulate(ROBOT, motion, plant, start), motion, plant, SampleRates(), start
    )
    return joint, start + onset, replace(log, id=f"{case.family} {case.number}")
