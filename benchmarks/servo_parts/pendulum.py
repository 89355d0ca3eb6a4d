"""Measured bus servos with a pendulum: the chain, the masses, and what has changed.

200 logs of 6 s: five motions at four gains, four masses and two lengths. All that was
chosen was chosen on the shorter pendulum; figures are of the longer one alone. A known
mass of 535 g gives each gain its drive, as `check` writes it.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations, permutations

import numpy as np

from benchmarks.harness.figures import NO_LOGS, Figures, all_missing
from benchmarks.harness.rates import at_least, at_most, rate
from benchmarks.measured_parts.arms import absent, folder_of
from residual.check.check import check_logs
from residual.diagnosis.diagnose import diagnose
from residual.drive import Drive
from residual.identification.identify import identify
from residual.recording import Recording, apply_drive
from residual.robot.robot import Robot, build_robot
from residual.signals.splitting import slice_recording
from warehouse.logs import read_log
from warehouse.logs.column_map import ColumnMap, SignalMap

MOTIONS = ("brutal", "lift_and_drop", "sin_sin", "sin_time_square", "up_and_down")
GAINS, MASSES, KNOWN = (4, 8, 16, 32), (535, 741, 969, 1168), 535  # g
TWICE = 8  # the gain that was logged twice
LENGTH, SHORTER = 150, 100  # mm; all was chosen on the shorter one
DECLARED = ("viscous", "coulomb", "rotor_inertia", "drive_damping")
# What a search by hand found: the goal's speed, and delays at gain 4, 8, 16 and 32.
SPEED, DELAYS = 4.8, (0.055, 0.045, 0.035, 0.03)
# Motions of an epoch: 30 s, three times 18 s; of halves, what is before and after.
ALL, TRIPLES = (0, 1, 2, 3, 4), ((0, 1, 2), (0, 1, 3), (1, 2, 4))
SPLITS = (((0, 1, 2), (3, 4)), ((1, 2, 4), (0, 3)))
CHAINS = {"goal_speed_first": 0.9, "delay_next": 0.75}
WEIGHED = {"mass_own_gain": 0.95, "mass_across_gains": 0.85}
CHANGES = {
    "load_named_18s": 0.8,
    "load_named_30s": 0.8,
    "load_named_36s": 0.9,
    "load_size": 0.9,
    "gain_named": 0.85,
    "gain_named_load": 0.0,  # at most
    "repeats_silent": 0.95,
    "length_named": 1.0,
}
BODIES = {"payload", "link_inertia", "link_body"}
CLASS = {"torque_gain", "viscous", "drive_damping"}
# Parts of the chain, and what the check says of them.
CHAIN = {
    "goal_speed": "the goal's speed is",
    "delay": "its delay is",
    "limit": "the limit of torque is",
}


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
def find_chain(gain: int, mass: int, length: int) -> tuple[Drive, tuple[str, ...]]:
    """The drive that the check writes for one setting; its parts, most nats first."""
    logs = read_setting(gain, mass, length)
    faults = check_logs(pendulum(length), logs).faults
    for fault in faults:
        for repair in fault.repairs:
            if repair.drive is not None:
                return repair.drive, rank_chain_parts(fault.evidence)
    return Drive(), ()


def rank_chain_parts(evidence: str) -> tuple[str, ...]:
    """Parts of the chain that the check names, by their nats, most first."""
    nats = {
        part: int(found[1])
        for part, words in CHAIN.items()
        if (found := re.search(rf"{words}[^;(]*\((\d+) nats\)", evidence))
    }
    return tuple(sorted(nats, key=lambda part: -nats[part]))


def _driven(logs: Sequence[Recording], drive: Drive) -> list[Recording]:
    return [apply_drive(r, replace(drive, enabled=r.drive.enabled)) for r in logs]


def chain_figures(quick: bool) -> Figures:
    """Whether the check finds what was left out of a map, in its order and size."""
    return all_missing(CHAINS, NO_LOGS) if absent("servo") else _score_chains(LENGTH, quick)


def _score_chains(length: int, quick: bool) -> Figures:
    first, second, data = [], [], {}
    for gain, expected in zip(GAINS, DELAYS, strict=True):
        for mass in MASSES[: 1 if quick else 4]:
            drive, parts = find_chain(gain, mass, length)
            near = bool(drive.goal_speed) and abs(drive.goal_speed[0] - SPEED) < 0.3
            first.append(parts[:1] == ("goal_speed",) and near)
            near = bool(drive.delay) and abs(drive.delay[0] - expected) <= 0.02
            second.append(parts[1:2] == ("delay",) and near)
            data[f"gain {gain}, {mass} g"] = (
                list(parts),
                [
                    [round(v, 4) for v in getattr(drive, part)]
                    for part in ("goal_speed", "delay", "gain", "limit")
                ],
            )
    return {
        name: at_least(rate(own, data=data), bar)
        for (name, bar), own in zip(CHAINS.items(), (first, second), strict=True)
    }


def mass_figures(quick: bool) -> Figures:
    """Masses by plain least squares with the drive of the known mass."""
    if absent("servo"):
        return all_missing(WEIGHED, NO_LOGS)
    robot, errors, across = pendulum(LENGTH), {}, {}
    gains = GAINS[1:2] if quick else GAINS
    first, _ = find_chain(8, KNOWN, LENGTH)
    for gain in gains:
        drive, _ = find_chain(gain, KNOWN, LENGTH)
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
        name: at_least(rate((abs(e) <= 0.1 for e in of.values()), data=of), bar)
        for (name, bar), of in zip(WEIGHED.items(), (errors, across), strict=True)
    }


def _mass(robot: Robot, logs: Sequence[Recording]) -> float:
    """First moment of the pendulum along its arm [kg m]."""
    return abs(identify(robot, logs, DECLARED).model.inertial[3])


def change_figures(quick: bool) -> Figures:
    """What has changed between two settings."""
    return all_missing(CHANGES, NO_LOGS) if absent("servo") else _score_changes(LENGTH, quick)


def developed_figures(quick: bool) -> Figures:
    """Chain and changes on what all was chosen on.

    For work on the method: the longer pendulum is looked at once, at its end.
    """
    if absent("servo"):
        return all_missing({"developed_gain_named_load": 0.0}, NO_LOGS)
    out = _score_chains(SHORTER, quick) | _score_changes(SHORTER, quick)
    return {f"developed_{name}": figure for name, figure in out.items()}


Pair = tuple[str, int, Sequence[Recording], Sequence[Recording], float]


def list_pairs(length: int) -> Iterator[Pair]:
    """Every comparison, fixed: its figure, the gain of its drive, both epochs, the load.

    Epochs of 36 s are of the gain that was logged twice; the load is the second mass
    over the first.
    """
    for gain in GAINS:
        for mass in MASSES[1:]:
            for motions in (ALL, *TRIPLES):
                epochs = (_pick(gain, m, length, motions) for m in (KNOWN, mass))
                yield f"load_named_{6 * len(motions)}s", gain, *epochs, mass / KNOWN
    for mass in MASSES[1:]:
        for motions in TRIPLES:
            epochs = (_pick(TWICE, m, length, motions, 1, 2) for m in (KNOWN, mass))
            yield "load_named_36s", TWICE, *epochs, mass / KNOWN
    for mass in MASSES:
        for first, then in permutations(GAINS, 2):
            epochs = (_pick(k, mass, length, ALL) for k in (first, then))
            yield "gain_named", first, *epochs, 1.0
        for gain, *epochs in _list_repeats(mass, length):
            yield "repeats_silent", gain, *epochs, 1.0
        if length == LENGTH:
            epochs = (_pick(TWICE, mass, x, ALL) for x in (SHORTER, LENGTH))
            yield "length_named", TWICE, *epochs, 1.0


def _list_repeats(mass: int, length: int) -> Iterator[tuple]:
    """Epochs of an arm that has not changed, each after the gain.

    All motions and each three again, three before the two others, and of all motions
    the first half before the second.
    """
    for motions in (ALL, *combinations(ALL, 3)):
        yield TWICE, *(_pick(TWICE, mass, length, motions, k) for k in (1, 2))
    for gain, repeat in ((TWICE, 2), *((k, 1) for k in GAINS)):
        for parts in SPLITS:
            yield gain, *(_pick(gain, mass, length, motions, repeat) for motions in parts)
        logs = _pick(gain, mass, length, ALL, repeat)
        yield gain, *zip(*map(_halve, logs), strict=True)


def _pick(
    gain: int, mass: int, length: int, motions: Sequence[int], *repeats: int
) -> list[Recording]:
    """Logs of some motions of a setting, of the first or of some repeats."""
    return [read_setting(gain, mass, length, k)[i] for k in repeats or (1,) for i in motions]


def _halve(log: Recording) -> tuple[Recording, Recording]:
    middle, end = len(log.t) // 2, len(log.t)
    return slice_recording(log, 0, middle), slice_recording(log, middle, end)


def _score_changes(length: int, quick: bool) -> Figures:
    hits: dict[str, list[bool]] = {name: [] for name in CHANGES}
    data: dict[str, list] = {name: [] for name in CHANGES}
    for figure, gain, first, second, load in [*list_pairs(length)][:: 20 if quick else 1]:
        drive, _ = find_chain(gain, KNOWN, length)
        named, more = _compare(pendulum(length), _driven(first, drive), _driven(second, drive))
        ids = f"{first[0].id}.. ({len(first)}) to {second[0].id}.. ({len(second)})"
        row = [ids, [sorted(n) for n in named]]
        body = bool(named and named[0] & BODIES)
        if figure == "repeats_silent":
            hit = not named
        elif figure == "gain_named":
            hit = bool(named and named[0] & CLASS)
            hits["gain_named_load"].append(any(n & BODIES for n in named))
        else:
            hit = body
        hits[figure].append(hit)
        if figure.startswith("load") and body:
            error = more / (load - 1) - 1
            hits["load_size"].append(abs(error) <= 0.2)
            row.append(round(error, 3))
        data[figure].append(row)
        print(f"[{figure}] {row} {hit}", flush=True)
    return {
        name: (at_most if name == "gain_named_load" else at_least)(
            rate(own, data=data[name]), CHANGES[name]
        )
        for name, own in hits.items()
        if own
    }


def _compare(
    robot: Robot, before: Sequence[Recording], logs: Sequence[Recording]
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
