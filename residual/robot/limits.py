"""Limits of a robot file that logs show to be placeholders.

Who writes a file without knowing a limit writes some number, and often the same one on
every joint. An arm that keeps none of them has not broken its limits: it has none.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.quantity import along
from residual.recording import Array, Recording, usual_speed
from residual.robot.robot import Robot

BROKEN = 1.5  # times a limit: files are a little too strict
ALIKE = 2.0  # to either side of the usual factor, where all joints break their limit
NEARLY = 0.8  # of the joints
FEWEST = 3  # joints: of two nobody says what is usual
STRIDE, SHARE = 0.1, 0.95  # s over which a speed is taken; of the samples are slower
# What arms do at most; beyond it columns or units are wrong, not the file. A torque
# that is so many times its limit is in another unit.
FASTEST, FARTHEST, LEAP = 8.0, 15.0, 1.5  # rad/s or m/s; rad or m, of a span, a step
STRONGEST = 30.0  # times the limit

_WORDS = {
    "velocity_limit": ("speed limit", "rad/s"),
    "torque_limit": ("torque limit", "N m"),
    "upper": ("range", "rad"),
}


def placeholders(robot: Robot, recordings: Sequence[Recording]) -> dict[str, str]:
    """Return which limits no joint keeps to, by the field of the robot, with words."""
    speeds = []
    for r in recordings:
        stride = max(1, round(STRIDE / float(np.median(np.diff(r.t)))))
        speeds.append(usual_speed(r, min(stride, len(r.t) // 4 or 1), SHARE))
    speed = np.max(speeds, axis=0)
    torque = np.max([np.quantile(np.abs(r.tau), SHARE, axis=0) for r in recordings], 0)
    # Another zero, or an encoder that begins again, leaves a range for what it is.
    span = np.max([np.ptp(r.q, axis=0) for r in recordings], axis=0)
    leap = np.max([np.abs(np.diff(r.q, axis=0)).max() for r in recordings])
    travel = robot.upper - robot.lower
    checked = {
        "velocity_limit": (speed, robot.velocity_limit, speed.max() < FASTEST),
        "torque_limit": (torque, robot.torque_limit, True),
        "upper": (span, travel, span.max() < FARTHEST and leap < LEAP),
    }
    out = {}
    for field, (size, limit, possible) in checked.items():
        ratio = size / limit
        if field == "torque_limit":
            possible = ratio.max() < STRONGEST
        if possible and _is_placeholder(ratio, limit):
            name, unit = _WORDS[field]
            worst = int(np.argmax(ratio))
            unit = along(unit) if robot.prismatic[worst] else unit
            out[field] = (
                f"the {name} of joint {worst + 1} is {limit[worst]:.3g} {unit} in the "
                f"robot file, and it reaches {size[worst]:.3g} {unit}"
            )
    return out


def _is_placeholder(ratio: Array, limit: Array) -> bool:
    """Whether all limits are one number that is broken, or nearly all by one factor."""
    if len(limit) < FEWEST or not np.isfinite(limit).all():
        return False
    broken = ratio > BROKEN
    middle = float(np.median(ratio))
    near = broken & (ratio < ALIKE * middle) & (ratio > middle / ALIKE)
    equal = np.ptp(limit) < 1e-3 * limit.max()
    return bool((equal and broken.any()) or near.mean() >= NEARLY)


def with_real_limits(robot: Robot, recordings: Sequence[Recording]) -> Robot:
    """Return the robot without the limits that are placeholders."""
    out = {k: np.full(robot.dof, np.inf) for k in placeholders(robot, recordings)}
    if "upper" in out:
        out["lower"] = -out["upper"]
    return replace(robot, **out) if out else robot
