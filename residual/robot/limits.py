"""Impossible joint limits, and placeholder limits contradicted by logs.

Unknown limits are often filled with arbitrary numbers: a torque too small to hold the
arm, one number for shoulder and wrist, or limits that every joint exceeds.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.quantity import convert_to_sliding_unit
from residual.recording import Array, Recording, compute_usual_speeds
from residual.robot.dynamics import compute_gravity_torque
from residual.robot.robot import Robot

POSTURES = 200  # postures in which the weight is evaluated
LIMP = 0.9  # of the largest weight in them: a smaller torque limit cannot hold the arm
SWIFT = {"rad/s": 40.0, "m/s": 15.0}  # faster than the joints of arms
UNEVEN = 20.0  # ratio of the weights of joints with the same torque limit


def find_limit_flaws(robot: Robot) -> list[tuple[int, str]]:
    """Return the joints (from 1) with an impossible limit, each with a description."""
    out = []
    for j, speed in enumerate(robot.velocity_limit):
        unit = "m/s" if robot.prismatic[j] else "rad/s"
        if np.isfinite(speed) and speed > SWIFT[unit]:
            words = f"The speed limit is {speed:.4g} {unit}"
            out.append((j + 1, f"{words}, expected at most {SWIFT[unit]:g} {unit}."))
    q = np.random.default_rng(0).uniform(*robot.ends, (POSTURES, robot.dof))
    weight = compute_gravity_torque(robot.model, q, robot.model.gravity.linear)
    most, limit = np.abs(weight).max(axis=0), robot.torque_limit
    for j in np.flatnonzero((limit < LIMP * most) & (robot.carried is None)):
        unit = "N" if robot.prismatic[j] else "N m"
        words = f"The torque limit is {limit[j]:.4g} {unit}, and the weight of the arm"
        out.append((int(j) + 1, f"{words} alone takes up to {most[j]:.4g} {unit}."))
    # A vertical joint carries no weight, so only the others are compared.
    loaded = most > 1e-3 * most.max(initial=0.0)
    same = np.isfinite(limit).all() and np.ptp(limit) == 0 and not any(robot.prismatic)
    if loaded.sum() > 2 and same and most.max() > UNEVEN * most[loaded].min():
        words = f"All joints have the torque limit {limit[0]:.4g} N m: a placeholder."
        out.append((1, words))
    return out


BROKEN = 1.5  # times a limit: files are a little too strict
ALIKE = 2.0  # around the median factor, if all joints exceed their limit
NEARLY = 0.8  # of the joints
FEWEST = 3  # joints: two are too few for a median
SHARE = 0.95  # of the samples are slower
# Largest values of any arm; beyond it columns or units are wrong, not the file. A torque
# this many times its limit is in another unit.
FASTEST, FARTHEST, LEAP = 8.0, 15.0, 1.5  # rad/s or m/s; rad or m, of a span, a step
STRONGEST = 30.0  # times the limit

_WORDS = {
    "velocity_limit": ("speed limit", "rad/s"),
    "torque_limit": ("torque limit", "N m"),
    "upper": ("range", "rad"),
}


def find_placeholder_limits(robot: Robot, logs: Sequence[Recording]) -> dict[str, str]:
    """Return the placeholder limits, by the field of the robot, with a description."""
    speed = compute_usual_speeds(logs, SHARE)
    torque = np.max([np.quantile(np.abs(r.tau), SHARE, axis=0) for r in logs], 0)
    # Another zero, or an encoder that wraps, does not invalidate a range.
    span = np.max([np.ptp(r.q, axis=0) for r in logs], axis=0)
    leap = np.max([np.abs(np.diff(r.q, axis=0)).max() for r in logs])
    travel = robot.upper - robot.lower
    strong = (torque / robot.torque_limit).max() < STRONGEST
    checked = {
        "velocity_limit": (speed, robot.velocity_limit, speed.max() < FASTEST),
        "torque_limit": (torque, robot.torque_limit, strong),
        "upper": (span, travel, span.max() < FARTHEST and leap < LEAP),
    }
    out = {}
    for key, (size, limit, possible) in checked.items():
        ratio = size / limit
        if possible and _is_placeholder(ratio, limit):
            name, unit = _WORDS[key]
            worst = int(np.argmax(ratio))
            unit = convert_to_sliding_unit(unit) if robot.prismatic[worst] else unit
            out[key] = (
                f"the {name} of joint {worst + 1} is {limit[worst]:.3g} {unit} in the "
                f"robot file, and it reaches {size[worst]:.3g} {unit}"
            )
    return out


def _is_placeholder(ratio: Array, limit: Array) -> bool:
    """Whether all limits are one number that is exceeded, or all by about one factor."""
    if len(limit) < FEWEST or not np.isfinite(limit).all():
        return False
    broken = ratio > BROKEN
    middle = float(np.median(ratio))
    near = broken & (ratio < ALIKE * middle) & (ratio > middle / ALIKE)
    equal = np.ptp(limit) < 1e-3 * limit.max()
    return bool((equal and broken.any()) or near.mean() >= NEARLY)


def drop_placeholder_limits(robot: Robot, recordings: Sequence[Recording]) -> Robot:
    """Return the robot without placeholder limits."""
    limits = find_placeholder_limits(robot, recordings)
    out = {key: np.full(robot.dof, np.inf) for key in limits}
    if "upper" in out:
        out["lower"] = -out["upper"]
    return replace(robot, **out) if out else robot
