"""Measured bus servos with a pendulum: the chain, the masses, and what has changed.

200 logs of 6 s: five motions at four gains, four masses and two lengths. All that was
chosen was chosen on the shorter pendulum; figures are of the longer one alone, but for
a few repeats. A known mass of 535 g gives each gain its drive, as `check` writes it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import permutations

import numpy as np

from benchmarks.harness.figures import NO_LOGS, Figures, all_missing, missing
from benchmarks.harness.rates import at_least, at_most, share
from benchmarks.measured_parts.arms import absent, folder_of
from residual.check.check import check_logs
from residual.diagnosis.diagnose import diagnose
from residual.drive import Drive
from residual.identification.identify import identify
from residual.recording import Recording, apply_drive
from residual.robot.robot import Robot, build_robot
from warehouse.logs import read_log
from warehouse.logs.column_map import ColumnMap, SignalMap

MOTIONS = ("brutal", "lift_and_drop", "sin_sin", "sin_time_square", "up_and_down")
GAINS, MASSES, KNOWN = (4, 8, 16, 32), (535, 741, 969, 1168), 535  # g
LENGTH, SHORTER = 150, 100  # mm; all was chosen on the shorter one
DECLARED = ("viscous", "coulomb", "rotor_inertia", "drive_damping")
# What a search by hand found: the goal's speed, and delays at gain 4, 8, 16 and 32.
SPEED, DELAYS = 4.8, (0.055, 0.045, 0.035, 0.03)
BARS = {
    "goal_speed_first": 0.9,
    "delay_next": 0.75,
    "mass_own_gain": 0.95,
    "mass_across_gains": 0.85,
    "load_named": 0.8,
    "load_named_18s": 0.8,
    "load_size": 0.9,
    "gain_named": 0.85,
    "repeats_silent": 0.95,
    "length_named": 1.0,
}
CHANGES = (*list(BARS)[4:],)
SHORT = 3  # logs of 18 s
BODIES = {"payload", "link_inertia", "link_body"}
CLASS = {"torque_gain", "viscous", "drive_damping"}


@cache
def pendulum(length: int) -> Robot:
    """The servo with the known mass at the end of its arm."""
    mass, lever = KNOWN / 1e3, length / 1e3
    urdf = f"""<robot name="pendulum"><link name="base"/><link name="arm"><inertial>
    <origin xyz="0 0 {-lever}"/><mass value="{mass}"/><inertia ixx="1e-5" iyy="1e-5"
    izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="servo"
    type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-3.3" upper="3.3" effort="6" velocity="10"/></joint></robot>"""
    return build_robot("pendulum", urdf, "{}")


@cache
def read_setting(gain: int, mass: int, length: int, repeat: int = 1):
    """Logs of one setting, with the goal as the drive's alone."""
    signals = {"q_ref": SignalMap(columns=("goal1",), unit="rad")}
    columns = ColumnMap(signals=signals, drive=Drive(enabled="enabled"))
    names = [f"{m}_kp{gain}_{mass}g_{length}mm_{repeat}.csv" for m in MOTIONS]
    paths = [str(folder_of("servo") / n) for n in names]
    return tuple(read_log(p, pendulum(length), columns)[0] for p in paths)


@cache
def find_drive(gain: int, mass: int, length: int) -> Drive:
    """The drive that the check writes for one setting."""
    logs = read_setting(gain, mass, length)
    faults = check_logs(pendulum(length), logs).faults
    drives = (r.drive for f in faults for r in f.repairs if r.drive is not None)
    return next(drives, Drive())


def _driven(logs: Sequence[Recording], drive: Drive) -> list[Recording]:
    return [apply_drive(r, replace(drive, enabled=r.drive.enabled)) for r in logs]


def chain_figures(quick: bool) -> Figures:
    """Whether the check finds what was left out of a map."""
    bars = {k: BARS[k] for k in ("goal_speed_first", "delay_next")}
    if absent("servo"):
        return all_missing(bars, NO_LOGS)
    speed, delay, total, values = 0, 0, 0, {}
    for gain, expected in zip(GAINS, DELAYS, strict=True):
        for mass in MASSES[: 1 if quick else 4]:
            drive = find_drive(gain, mass, LENGTH)
            total += 1
            speed += bool(drive.goal_speed) and abs(drive.goal_speed[0] - SPEED) < 0.3
            delay += bool(drive.delay) and abs(drive.delay[0] - expected) <= 0.02
            values[f"gain {gain}, {mass} g"] = [
                [round(v, 4) for v in getattr(drive, part)]
                for part in ("goal_speed", "delay", "gain", "limit")
            ]
    return {
        "goal_speed_first": at_least(share(speed, total, data=values), bars["goal_speed_first"]),
        "delay_next": at_least(share(delay, total), bars["delay_next"]),
    }


def mass_figures(quick: bool) -> Figures:
    """Masses by plain least squares with the drive of the known mass."""
    bars = {k: BARS[k] for k in ("mass_own_gain", "mass_across_gains")}
    if absent("servo"):
        return all_missing(bars, NO_LOGS)
    robot, errors, across = pendulum(LENGTH), {}, {}
    gains = GAINS[1:2] if quick else GAINS
    first = find_drive(8, KNOWN, LENGTH)
    for gain in gains:
        drive = find_drive(gain, KNOWN, LENGTH)
        least = _mass(robot, _driven(read_setting(gain, KNOWN, LENGTH), drive))
        for mass in MASSES[1:]:
            own = _mass(robot, _driven(read_setting(gain, mass, LENGTH), drive))
            errors[f"gain {gain}, {mass} g"] = round(own / least * KNOWN / mass - 1, 4)
            if gain >= 8:  # the gain of the register alone carries the factor over
                base = _mass(robot, _driven(read_setting(8, KNOWN, LENGTH), first))
                ratio = first.gain[0] * gain / 8 / drive.gain[0]
                value = own * ratio / base * KNOWN / mass - 1
                across[f"gain {gain}, {mass} g"] = round(value, 4)
    return {
        f"mass_{name}": at_least(
            share(sum(abs(e) <= 0.1 for e in of.values()), len(of), data=of), bars[f"mass_{name}"]
        )
        for name, of in (("own_gain", errors), ("across_gains", across))
    }


def _mass(robot: Robot, logs: Sequence[Recording]) -> float:
    """First moment of the pendulum along its arm [kg m]."""
    return abs(identify(robot, logs, DECLARED).model.inertial[3])


def change_figures(quick: bool) -> Figures:
    """What has changed between two settings, 30 s of logs each."""
    bars = {k: BARS[k] for k in CHANGES}
    if absent("servo"):
        return all_missing(bars, NO_LOGS)
    return _score_changes(LENGTH, quick, bars)


def developed_change_figures(quick: bool) -> Figures:
    """The same on what all was chosen on, and from each gain to each other one.

    For work on the method: the longer pendulum is looked at once, at its end.
    """
    if absent("servo"):
        return {"developed_gain_named_load": missing(0, NO_LOGS)}
    out = _score_changes(SHORTER, quick, dict.fromkeys(CHANGES))
    robot, data, loads = pendulum(SHORTER), {}, []
    for mass in MASSES[1:2] if quick else MASSES:
        for first, then in permutations(GAINS[1:3] if quick else GAINS, 2):
            drive = find_drive(first, KNOWN, SHORTER)
            logs = (_driven(read_setting(k, mass, SHORTER), drive) for k in (then, first))
            named, _ = _compare(robot, *logs)
            loads.append(any(n & BODIES for n in named))
            data[f"{mass} g, gain {first} to {then}"] = [sorted(n) for n in named]
    out["gain_named_load"] = at_most(share(sum(loads), len(loads), data=data), 0.0)
    return {f"developed_{name}": figure for name, figure in out.items()}


def _score_changes(length: int, quick: bool, bars: Mapping) -> Figures:
    robot, data = pendulum(length), {}
    hits = {name: [] for name in bars}
    for gain in GAINS[1:2] if quick else GAINS:
        drive = find_drive(gain, KNOWN, length)
        before = _driven(read_setting(gain, KNOWN, length), drive)
        for mass in MASSES[1:2] if quick else MASSES[1:]:
            logs = _driven(read_setting(gain, mass, length), drive)
            named, change = _compare(robot, logs, before)
            load = bool(named and named[0] & BODIES)
            hits["load_named"].append(load)
            error = change / (mass / KNOWN - 1) - 1
            if load:
                hits["load_size"].append(abs(error) <= 0.2)
            short, _ = _compare(robot, logs[:SHORT], before[:SHORT])
            hits["load_named_18s"].append(bool(short and short[0] & BODIES))
            row = [sorted(n) for n in named], round(error, 3), [*map(sorted, short)]
            data[f"gain {gain}, {KNOWN} to {mass} g"] = row
    drive = find_drive(8, KNOWN, length)
    for mass in MASSES[:1] if quick else MASSES:
        first, again = (_driven(read_setting(8, mass, length, k), drive) for k in (1, 2))
        named, _ = _compare(robot, again, first)
        hits["repeats_silent"].append(not named)
        data[f"{mass} g again"] = [sorted(n) for n in named]
        if length == LENGTH:
            shorter = _driven(read_setting(8, mass, SHORTER), drive)
            named, _ = _compare(robot, first, shorter)
            hits["length_named"].append(bool(named) and named[0] & BODIES != set())
            data[f"{mass} g, longer"] = [sorted(n) for n in named]
        for other in (4, 16):
            logs = _driven(read_setting(other, mass, length), drive)
            named, _ = _compare(robot, logs, first)
            hits["gain_named"].append(bool(named and named[0] & CLASS))
            data[f"{mass} g, gain 8 to {other}"] = [sorted(n) for n in named]
    return {
        name: at_least(share(sum(own), len(own), data=data), bars[name])
        for name, own in hits.items()
        if own
    }


def _compare(
    robot: Robot, logs: Sequence[Recording], before: Sequence[Recording]
) -> tuple[list[set[str]], float]:
    """Names of each finding with all that explains the same; share of weight more."""
    before = [replace(r, id=f"{r.id} before") for r in before]
    found = diagnose(robot, logs, before, declared=DECLARED)
    names = [{f.name, *(e.name for e in f.equivalent)} for f in found.verdict.effects]
    q = np.array([[np.pi / 2], [-np.pi / 2]])
    first, second = (
        np.ptp(found.models[name].torque(q, 0 * q, 0 * q)[:, 0])
        for name in ("nominal", "augmented")
    )
    return names, float(second / first - 1)
