"""Arms that are mounted otherwise, and slips in twos: cases by seed, and what is said.

The lists are drawn before anything runs. Seeds from 606000 and 605000 on
decide, once; a quick run has its own.
"""

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.check_parts.arms import SEVEN, SIX, chain, recorded, seven, table_of
from benchmarks.check_parts.judge import read
from benchmarks.harness.figures import Figures, figure
from benchmarks.harness.rates import at_least, share
from benchmarks.synthetic.motions import make_motion
from benchmarks.synthetic.quasi_static import Plant
from flows.steps.check import check
from residual.check.check import check_logs
from residual.check.result import Fault
from residual.recording import Recording
from residual.robot.dynamics import gravity_torque
from residual.robot.robot import Robot, load_robot, with_gravity
from sim.engine.records import Hidden, stream
from sim.plant.sizes import usual_limits

_SEEDS = {"mounted": 606000, "twos": 605000}
_QUICK = 500_000  # added to them
_EARTH, _NEAR = 9.81, 3.0  # m/s^2; degrees within which a direction is right
_FAMILIES, _SECONDS, _RATE = ("fourier", "cyclic", "move_stop_move"), 12.0, 250.0
_ANGLES = (180, 90, 90, 90, 90, 45, 45, 15, 15, 15)  # degrees from upright
_PAIRS = {
    "order and unit": {"joint_order", "torque_unit"},
    "sign and unit": {"torque_sign", "torque_unit"},
    "gravity and unit": {"mounting", "torque_unit"},
    "time and unit": {"time_unit", "torque_unit"},
    "removed and load": {"gravity_removed"},
}
_OTHER = "other"


def _arm(name: str) -> Robot:
    if name == SIX:
        return load_robot("irb140")
    return seven() if name == SEVEN else chain(_OTHER, "zyyzyz", 0.4, 9.0)


def _logs(robot: Robot, hidden: Sequence[Hidden], seed: int) -> list[Recording]:
    plant, out = Plant(robot, tuple(hidden), seed), []
    for i, family in enumerate(_FAMILIES):
        rng = stream(seed, f"motion/{robot.name}/{family}")
        motion = make_motion(family, usual_limits(robot), _SECONDS, _RATE, rng)
        log = recorded(plant, motion, f"{robot.name}_{family}", 22.0 * i)
        out.append(replace(log, qd=None))
    return out


def _load(robot: Robot, mass: float) -> Hidden:
    at = {"com_x": 0.0, "com_y": 0.0, "com_z": 0.1}
    return Hidden("payload", (robot.dof,), {"mass": mass, **at})


def mounted_figures(quick: bool) -> Figures:
    """Forty arms under another gravity, with and without 3 kg; a hundred upright."""
    right, upright, seed = 0, 0, _SEEDS["mounted"] + _QUICK * quick
    turns = [(n, a, m) for n in (SIX, SEVEN) for a in _ANGLES for m in (0.0, 3.0)]
    turns = turns[::10] if quick else turns
    for i, (name, degrees, mass) in enumerate(turns):
        robot, rng = _arm(name), stream(seed + i, "mounting")
        around, angle = rng.uniform(0, 2 * np.pi), np.deg2rad(degrees)
        if degrees == 90:
            around = np.pi / 2 * (i // 2 % 4)
        level = np.sin(angle) * np.array([np.cos(around), np.sin(around)])
        true = _EARTH * np.array([*level, -np.cos(angle)])
        hidden = [_load(robot, mass)] if mass else []
        logs = _logs(with_gravity(robot, true), hidden, seed + i)
        faults = check_logs(robot, logs).faults
        found = [f for f in faults if f.kind == "mounting" and f.certain]
        if len(faults) == len(found) == 1:
            cosine = np.dot(found[0].repairs[0].gravity, true) / _EARTH**2
            right += bool(np.degrees(np.arccos(min(1.0, cosine))) < _NEAR)
        else:
            print(name, degrees, mass, [(f.kind, f.certain) for f in faults])
    count = 10 if quick else 100
    for i in range(count):
        robot = _arm((SIX, SEVEN)[i % 2])
        hidden = [_load(robot, 3.0)] if i % 4 > 1 else []
        faults = check_logs(robot, _logs(robot, hidden, seed + 1000 + i)).faults
        upright += any(f.kind == "mounting" for f in faults)
    return {
        "mounting_right": at_least(share(right, len(turns)), 1.0),
        "upright_suspected": figure(upright, 0, count),
    }


def _cases() -> Iterator[tuple[str, str, str]]:
    for name in (SIX, SEVEN, _OTHER):
        for pair in _PAIRS:
            for kind in ("none", "none", "spring", "load"):
                yield name, pair, kind


def _pasted(
    robot: Robot, logs: Sequence[Recording]
) -> tuple[Sequence[Fault], Sequence[Fault]]:
    """Check logs; put the lines where they belong, and return what is certain then."""
    with TemporaryDirectory() as folder:
        place, tables = Path(folder), [table_of(log) for log in logs]
        faults = check(read(place, tables, robot)).faults
        lines = {
            line
            for f in faults
            if f.certain and f.repair
            for line in f.repair.split("\n")
        }
        gravity = [line for line in lines if line.startswith("gravity")]
        columns = place / "COLUMNS.toml"
        columns.write_text("\n".join(sorted(lines - {*gravity})), encoding="utf-8")
        if any(f.kind == "gravity_removed" and f.certain for f in faults):
            robot = with_gravity(robot, [0.0, 0.0, 0.0])
        for line in gravity:
            robot = with_gravity(robot, tomllib.loads(line)["gravity"])
        return faults, check(read(place, tables, robot, str(columns))).certain


def twos_figures(quick: bool) -> Figures:
    """Sixty logs with two slips each, some beside a hidden spring or load."""
    right, false, mended, cases = 0, 0, 0, list(_cases())
    for i, (name, pair, kind) in enumerate(cases[::6] if quick else cases):
        robot, seed = _arm(name), _SEEDS["twos"] + _QUICK * quick + i
        rng, wanted = stream(seed, "slips"), _PAIRS[pair]
        loaded = kind == "load" or pair == "removed and load"
        spring = Hidden("spring", (3,), {"stiffness": 25.0, "rest": 0.1})
        hidden = [spring] if kind == "spring" else []
        hidden += [_load(robot, rng.uniform(1.0, 3.0))] if loaded else []
        logs, given = _logs(robot, hidden, seed), robot
        order, sign = list(range(robot.dof)), np.ones(robot.dof)
        unit, late = 1 / rng.uniform(5, 15, robot.dof), 1.0
        a, b = sorted(rng.choice(4, 2, replace=False))
        if "joint_order" in wanted:
            order[a], order[b] = order[b], order[a]
        if "torque_sign" in wanted:
            sign[rng.integers(1, 3)] = -1.0
        if "mounting" in wanted:
            given = with_gravity(robot, [_EARTH, 0.0, 0.0])
        late = 2.0 if "time_unit" in wanted else 1.0
        removed = "gravity_removed" in wanted
        unit = np.ones(robot.dof) if removed else unit
        down = robot.model.gravity.linear
        spoiled = []
        for log in logs:
            weight = gravity_torque(robot.model, log.q, down) if removed else 0.0
            tau = ((log.tau - weight) * unit * sign)[:, order]
            spoiled.append(replace(log, t=log.t * late, q=log.q[:, order], tau=tau))
        faults, again = _pasted(given, spoiled)
        kinds = {f.kind for f in faults if f.certain}
        mended += kinds == wanted and not again
        # Factors of a hundred are of gears: the kind is the other name of a unit.
        false += bool(kinds - wanted - {"gear_ratio"})
        right += kinds == wanted
        if kinds != wanted:
            print(name, pair, kind, [(f.kind, f.joints, f.certain) for f in faults])
    count = len(cases[::6] if quick else cases)
    return {
        "pairs_right": at_least(share(right, count), 0.85),
        "pairs_mended": at_least(share(mended, count), 0.85),
        "pairs_false_certain": figure(false, 0, count),
    }
