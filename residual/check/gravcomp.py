"""Whether a log contains the weight that the file declares as compensated."""

from dataclasses import replace

import numpy as np

from residual.check.evidence import CheckMotion
from residual.check.result import Fault, Repair
from residual.errors import join_with_commas
from residual.robot.dynamics import PER_LINK, compute_robot_regressor, read_inertial_parameters
from residual.robot.robot import Robot

_FEWEST_ROWS = 10  # of a joint that shows the weight on its drive
_NEAR = 0.2  # of that weight: distance from all or none of it that is certain


def find_weight_in_torque(robot: Robot, motion: CheckMotion) -> tuple[Robot, list[Fault]]:
    """Return the arm with the weight that the logs show, and the fault if different.

    A file may declare that a force other than the drives carries a part of the weight;
    only the torque shows whether this held for a log: apart from friction and rotors it
    lacks a share of that part, near one or near zero.
    """
    if robot.carried is None:
        return robot, []
    free = replace(robot, carried=None)
    rows, bodies = (motion.q, motion.qd, motion.qdd), read_inertial_parameters(robot.model)
    regressor = compute_robot_regressor(free, *rows)
    whole = regressor @ bodies
    held = whole - compute_robot_regressor(robot, *rows) @ bodies
    parts = []
    for j in np.flatnonzero(motion.moving.sum(axis=0) > _FEWEST_ROWS):
        use, tau = motion.moving[:, j], motion.tau[:, j]
        qd, qdd = motion.qd[use, j], motion.qdd[use, j]
        drive = np.stack([np.ones_like(qd), qd, np.sign(qd), qdd], axis=1)
        load = regressor[use, j, -PER_LINK:]  # a tool missing in the file
        part = np.column_stack([held[use, j], (whole[:, j] - tau)[use], load])
        part -= drive @ np.linalg.lstsq(drive, part, rcond=None)[0]
        parts.append(part / max(float(np.sqrt(np.mean(tau[use] ** 2))), 1e-9))
    if not parts:
        return robot, []
    rows = np.concatenate(parts)
    load = rows[:, 2:]
    alone = rows[:, :2] - load @ np.linalg.lstsq(load, rows[:, :2], rcond=None)[0]
    power = float(rows[:, 0] @ rows[:, 0])
    # On few joints a load may look like the weight of all links.
    apart = float(alone[:, 0] @ alone[:, 0]) > _NEAR**2 * power
    looked_at = alone if apart else rows
    share = float(looked_at[:, 0] @ looked_at[:, 1])
    share /= max(float(looked_at[:, 0] @ looked_at[:, 0]), 1e-300)
    if abs(share) > 0.5:
        return robot, []
    words = (
        f"The torque has the weight of {join_with_commas(robot.carried.links)}, which "
        "the file says is held beside the drives (gravcomp): it lacks "
        f"{100 * abs(share):.0f} % of it."
    )
    repairs = (Repair("robot", gravcomp=False),)
    sure = apart and abs(share) < _NEAR
    return free, [Fault("robot_file", (), sure, words, repairs)]
