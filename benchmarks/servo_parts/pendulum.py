"""Measured logs of a bus servo with a pendulum: where models go on held-out motion.

A setting is a gain, a mass and a length: four motions are fitted and the fifth is held
out, another one in each setting. The chain of the drive is what the check finds. The
peer is how servo models are fitted elsewhere: the best of 2 000 random draws of gain,
inertia, viscous and dry friction by the position on the same fitted motions, given that
very chain. One motion has the drive off in a part; it is among the fitted ones, since
nothing else separates friction from the damping of a drive.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.harness.figures import (
    FEW,
    NO_LOGS,
    Figures,
    all_missing,
    all_partial,
    figure,
)
from benchmarks.harness.rates import at_least, share
from benchmarks.measured_parts.arms import data_folder
from residual.check.drive_chain import find_drive_faults
from residual.diagnosis.diagnose import diagnose
from residual.drive import limit_goal
from residual.recording import Array, Recording, apply_drive
from residual.robot.robot import Robot, build_robot
from sim.engine.plant_records import create_random_stream
from warehouse.logs import read_log

GAINS, MASSES, LENGTHS = (4, 8, 16, 32), (535, 741, 969, 1168), (100, 150)
# The first one has the drive off in a part, and is always fitted.
MOTIONS = ("lift_and_drop", "brutal", "sin_sin", "sin_time_square", "up_and_down")
DUTY, UNIT = 0.165, 2.9  # of the firmware, per rad and gain; N m at full duty, by maker
DRAWS, STEP, GRAVITY = 2000, 2e-3, 9.81
NEAR, BELOW = 0.030, 0.8  # rad; of the peer's distance
URDF = """<robot name="pendulum"><link name="base"/><link name="bob"><inertial>
<origin xyz="0 0 -{length}"/><mass value="{mass}"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="servo" type="continuous"><parent link="base"/><child link="bob"/>
<axis xyz="0 1 0"/><limit effort="30" velocity="10"/></joint></robot>"""

Setting = tuple[int, int, int]  # gain, mass [g], length [mm]


def position_figures(quick: bool) -> Figures:
    """Distance of our models and of the peer from the held-out motion, by setting."""
    folder = data_folder()
    bars = {"servo_position_rms": NEAR, "servo_position_below_peer": 0.8}
    if folder is None or not (folder / "servo").is_dir():
        return all_missing(bars, NO_LOGS)
    rows = [compare(folder / "servo", s, i) for i, s in list_settings(False, quick)]
    return all_partial(summarize(rows), FEW if quick else "")


def list_settings(developed: bool, few: bool) -> list[tuple[int, Setting]]:
    """Return every other setting: those we developed on, or those we report."""
    every = [(k, m, x) for k in GAINS for m in MASSES for x in LENGTHS]
    half = [(i, s) for i, s in enumerate(every) if (i + i // 2) % 2 != developed]
    return half[:: 8 if few else 1]


def summarize(rows: list[dict[str, float]]) -> Figures:
    """Return shares of settings, and the distances themselves."""
    ours, peer, before = (
        np.array([row[name] for row in rows]) for name in ("ours", "peer", "nominal")
    )
    pooled = float(np.sqrt(np.mean(ours**2)))
    below = share(int((ours <= BELOW * peer).sum()), len(rows))
    return {
        "servo_position_below_peer": at_least(below, 0.8),
        "servo_position_rms": figure(pooled, NEAR, len(rows)),
        "servo_position_rms_median": figure(float(np.median(ours)), None, len(rows)),
        "servo_position_rms_nominal": figure(float(np.median(before)), None, len(rows)),
        "servo_position_rms_peer": figure(float(np.median(peer)), None, len(rows)),
    }


def compare(folder: Path, setting: Setting, number: int) -> dict[str, float]:
    """Fit four motions of a setting; return distances on the fifth [rad]."""
    _, mass, length = setting
    robot = build_pendulum(mass / 1e3, length / 1e3)
    logs = [read(folder, robot, motion, setting) for motion in MOTIONS]
    held_out = logs.pop(1 + number // 2 % (len(MOTIONS) - 1))
    _, fit = find_drive_faults(robot, logs)
    held_out = apply_drive(held_out, fit[0].drive)
    verdict = diagnose(robot, fit, held_out=[held_out]).verdict
    position = verdict.error.position.overall
    draws = Draws(setting)
    best = int(np.argmin(sum(draws.miss(log) for log in fit)))
    peer = float(np.sqrt(draws.miss(held_out)[best]))
    nominal, ours = (
        np.inf if position[k] is None else position[k] for k in ("nominal", "augmented")
    )
    named = ", ".join(effect.name for effect in verdict.effects)
    line = f"[{number}] {held_out.id}: {nominal:.3f} -> {ours:.4f} ({named})"
    print(f"{line}, peer {peer:.4f}", flush=True)
    return {"ours": ours, "peer": peer, "nominal": nominal}


def build_pendulum(mass: float, length: float) -> Robot:
    """Return the arm as its builder knows it: a weighed bob on a rod."""
    values = {"mass": mass, "length": length, "i": 0.02 * mass * length**2}
    return build_robot("pendulum", URDF.format(**values), "{}")


def read(folder: Path, robot: Robot, motion: str, setting: Setting) -> Recording:
    """Return the first log of a motion, with the gain that its firmware was given."""
    gain, mass, length = setting
    path = folder / f"{motion}_kp{gain}_{mass}g_{length}mm_1.csv"
    columns = {
        "q_ref": {"columns": ["goal1"], "unit": "rad"},
        "drive": {"gain": [DUTY * gain * UNIT], "enabled": "enabled"},
    }
    return read_log(str(path), replace(robot, columns=columns))[0]


class Draws:
    """The random draws of the peer in one setting, all integrated at once."""

    def __init__(self, setting: Setting) -> None:
        gain, mass, length = setting
        rng = create_random_stream(gain * mass + length, "servo/peer")
        self.weight = mass / 1e3 * GRAVITY * length / 1e3  # N m
        lean = mass / 1e3 * (length / 1e3) ** 2  # kg m^2
        self.gain = DUTY * gain * rng.uniform(2.0, 10.0, DRAWS)  # N m/rad
        self.inertia = lean + np.exp(rng.uniform(*np.log([1e-3, 0.1]), DRAWS))
        self.viscous = np.exp(rng.uniform(*np.log([0.02, 5.0]), DRAWS))
        self.coulomb = rng.uniform(0.0, 0.6, DRAWS)

    def miss(self, log: Recording) -> Array:
        """Return each draw's mean squared distance from a log [rad^2]. (DRAWS,)."""
        t = np.arange(log.t[0], log.t[-1], STEP)
        goal = np.interp(t, log.t, limit_goal(log.drive, log.q_ref, log.t)[:, 0])
        held = np.searchsorted(log.t, t + 1e-9, side="right") - 1
        on = np.ones(len(t)) if log.enabled is None else log.enabled[held, 0]
        drive = log.drive
        far = drive.values("limit", 1)[0] / drive.values("gain", 1)[0]  # rad
        q, v = np.full(DRAWS, log.q[0, 0]), np.zeros(DRAWS)
        path = np.empty((len(t), DRAWS))
        for k in range(len(t)):
            path[k] = q
            torque = on[k] * self.gain * np.clip(goal[k] - q, -far, far)
            v = v + STEP * (torque - self.weight * np.sin(q)) / self.inertia
            v = v / (1 + STEP * self.viscous / self.inertia)
            rub = STEP * self.coulomb / self.inertia
            v = np.sign(v) * np.maximum(np.abs(v) - rub, 0.0)
            q = q + STEP * v
        at = np.minimum(np.round((log.t - t[0]) / STEP).astype(int), len(t) - 1)
        return np.mean((path[at] - log.q) ** 2, axis=0)
