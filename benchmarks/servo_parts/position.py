"""Measured logs of a bus servo with a pendulum: where models go on held-out motion.

A setting is a gain, a mass and a length: four motions are fitted and the fifth is held
out, another one in each setting. The chain of the drive is what the check finds. The
peer is how servo models are fitted elsewhere: the best of 2 000 random draws of gain,
inertia, viscous and dry friction by the position on the same fitted motions, given that
very chain. One motion has the drive off in a part; it is among the fitted ones, since
nothing else separates friction from the damping of a drive. Gears of such a servo rub in
proportion to their load, which is declared; without it the figure is given beside.
"""

import numpy as np

from benchmarks.harness.figures import NO_LOGS, Figures, all_missing, figure
from benchmarks.harness.rates import at_least, rate
from benchmarks.measured_parts.arms import absent
from benchmarks.servo_parts.pendulum import (
    GAINS,
    LENGTH,
    MASSES,
    MOTIONS,
    SHORTER,
    pendulum,
    read_setting,
)
from residual.check.drive_chain import find_drive_faults
from residual.diagnosis.diagnose import diagnose
from residual.drive import limit_goal
from residual.recording import Array, Recording, apply_drive
from sim.engine.plant_records import create_random_stream

DUTY = 0.165  # of the firmware, per rad and gain
OFF = "lift_and_drop"  # the motion with the drive off in a part, which is always fitted
GEARED = ("viscous", "coulomb", "rotor_inertia", "load_friction")  # declared
DRAWS, STEP, GRAVITY = 2000, 2e-3, 9.81
NEAR, BELOW = 0.030, 0.8  # rad; of the peer's distance
Setting = tuple[int, int, int]  # gain, mass [g], length [mm]


def position_figures(quick: bool) -> Figures:
    """Distance of our models and of the peer from the held-out motion, by setting."""
    if absent("servo"):
        bars = {"servo_position_rms": NEAR, "servo_position_below_peer": 0.8}
        return all_missing(bars, NO_LOGS)
    rows = [compare(setting, i) for i, setting in list_settings(quick)]
    return summarize(rows)


def list_settings(few: bool) -> list[tuple[int, Setting]]:
    """Return every other setting: the rest is what we developed on."""
    every = [(k, m, x) for k in GAINS for m in MASSES for x in (SHORTER, LENGTH)]
    half = [(i, s) for i, s in enumerate(every) if (i + i // 2) % 2]
    return half[:: 8 if few else 1]


def summarize(rows: list[dict[str, float]]) -> Figures:
    """Return shares of settings, and the distances themselves."""
    ours, usual, peer, before = (
        np.array([row[name] for row in rows]) for name in ("ours", "usual", "peer", "nominal")
    )
    pooled, plain = (float(np.sqrt(np.mean(x**2))) for x in (ours, usual))
    below = rate(ours <= BELOW * peer)
    return {
        "servo_position_below_peer": at_least(below, 0.8),
        "servo_position_rms": figure(pooled, NEAR, len(rows)),
        "servo_position_rms_usual": figure(plain, None, len(rows)),
        "servo_position_rms_median": figure(float(np.median(ours)), None, len(rows)),
        "servo_position_rms_nominal": figure(float(np.median(before)), None, len(rows)),
        "servo_position_rms_peer": figure(float(np.median(peer)), None, len(rows)),
    }


def compare(setting: Setting, number: int) -> dict[str, float]:
    """Fit four motions of a setting; return distances on the fifth [rad]."""
    robot, logs = pendulum(setting[2]), list(read_setting(*setting))
    movable = [i for i, motion in enumerate(MOTIONS) if motion != OFF]
    held_out = logs.pop(movable[number // 2 % len(movable)])
    _, fit = find_drive_faults(robot, logs)
    held_out = apply_drive(held_out, fit[0].drive)
    verdicts = [diagnose(robot, fit, (), [held_out], names).verdict for names in (GEARED, None)]
    position, usual = (v.error.position.overall for v in verdicts)
    draws = Draws(setting)
    best = int(np.argmin(sum(draws.miss(log) for log in fit)))
    peer = float(np.sqrt(draws.miss(held_out)[best]))
    out = {"nominal": position["nominal"], "ours": position["augmented"]}
    out |= {"usual": usual["augmented"]}
    out = {k: np.inf if miss is None else miss for k, miss in out.items()} | {"peer": peer}
    named = ", ".join(effect.name for effect in verdicts[0].effects)
    print(f"[{number}] {held_out.id}: {out} ({named})", flush=True)
    return out


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
