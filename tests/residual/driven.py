"""An arm of one joint whose drive follows a goal, without a torque sensor."""

from dataclasses import replace

import numpy as np

from residual.drive import Drive
from residual.recording import Recording, apply_drive
from residual.robot.robot import Robot
from tests.residual.arms import arm

ONE = ("0 1 0",)
DRIVE = Drive(gain=(60.0,), limit=(30.0,), delay=(0.04,), goal_speed=(2.0,))
DAMPING = 4.0  # N m s/rad while the drive is on
RATE, STEP = 100, 1e-3  # Hz, s


def pendulum(toml: str = "") -> Robot:
    return arm(ONE, toml)


def drive_log(
    seed: int, seconds: float = 9.0, drive: Drive = DRIVE, off=(), load: float = 0.0
) -> Recording:
    """Simulate a log: steps and waves of the goal, off within (start, end) [s].

    Args:
        load: Mass at the centre of the link [kg].
    """
    rng, robot = np.random.default_rng(seed), pendulum()
    body = list(robot.model.inertias)[1]
    mass, (x, _, z) = body.mass + load, body.lever
    inertia = body.inertia[1, 1] + mass * (x**2 + z**2)
    t = np.arange(0, seconds, STEP)
    knots = np.arange(0, seconds + 1, 1.2)
    goal = rng.uniform(-1, 1, len(knots))[np.searchsorted(knots, t, side="right") - 1]
    goal = np.where(t < seconds / 2, goal, np.sin(2.2 * t + rng.uniform(0, 6)))
    (gain,), (limit,), (delay,), (speed,) = (drive.gain, drive.limit, drive.delay, drive.goal_speed)
    followed = np.empty_like(goal)
    at = goal[0]
    for i, end in enumerate(goal):
        at += np.clip(end - at, -speed * STEP, speed * STEP)
        followed[i] = at
    late = round(delay / STEP)
    followed = np.concatenate([np.full(late, followed[0]), followed[: -late or None]])
    on = np.ones(len(t))
    for start, end in [off] if off else []:
        on[(t >= start) & (t < end)] = 0.0
    q, qd, out = goal[0], 0.0, np.empty_like(t)
    for i in range(len(t)):
        torque = on[i] * (np.clip(gain * (followed[i] - q), -limit, limit) - DAMPING * qd)
        weight = mass * 9.81 * (x * np.cos(q) + z * np.sin(q))
        torque += weight - 0.3 * np.tanh(qd / 0.01)
        qd += STEP * torque / inertia
        q += STEP * qd
        out[i] = q
    every = slice(None, None, round(1 / RATE / STEP))
    q = out[every, None] + 2e-4 * rng.normal(size=(len(out[every]), 1))
    q_ref, enabled = goal[every, None], on[every, None]
    own = Recording(f"log{seed}", robot.name, t[every], q, 0 * q, q_ref=q_ref)
    own = replace(own, enabled=enabled if off else None)
    return apply_drive(own, Drive())
