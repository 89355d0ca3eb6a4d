"""Readings of time, of gravity and of single torques that suit the physics better."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

from residual.check.assignment import Scores, torque_scores
from residual.check.motion import Motion
from residual.check.proportion import out_of_proportion
from residual.check.result import Fault, Repair
from residual.check.rules import CHECK
from residual.names import listed
from residual.robot.robot import Robot

Found = tuple[float, Fault | None]


def other_world(robot: Robot, motion: Motion) -> list[Fault]:
    """Try other clocks, other directions of gravity, and scales of single torques."""
    scores = torque_scores(robot, motion)
    given = _total(scores)
    found = [_clock(robot, motion, given), _gravity(robot, motion, given)]
    found = [each for each in found if each[0] > CHECK.world]
    found.append(out_of_proportion(robot, motion))
    # One of them explains what the others would have to.
    _, fault = max(found, key=lambda each: each[0])
    return [] if fault is None else [fault]


def _total(scores: Scores) -> float:
    one = np.ones(1)
    return sum(float(scores.evidence(j, j, one)[0]) for j in range(len(scores.rows)))


def _clock(robot: Robot, motion: Motion, given: float) -> Found:
    tried = {}
    for factor in CHECK.times:
        qd, qdd = motion.qd / factor, motion.qdd / factor**2
        slower = replace(motion, qd=qd, qdd=qdd)
        tried[factor] = _total(torque_scores(robot, slower)) - given
    best = max(tried, key=tried.__getitem__)
    words = (
        "Weight and inertia of this arm do not go together in the time that is given; "
        f"with time times {best:g} they fit better by {tried[best]:.0f} nats."
    )
    certain = tried[best] > CHECK.certain_time
    fault = Fault("time_unit", (), certain, words, (Repair("t", scale=best),))
    return tried[best], fault


def _gravity(robot: Robot, motion: Motion, given: float) -> Found:
    now = robot.model.gravity.linear
    size = float(np.linalg.norm(now))
    if size == 0:
        return 0.0, None
    tried = {}
    for axis in range(3):
        for sign in (1, -1):
            direction = sign * size * np.eye(3)[axis]
            if direction @ now > 0.9 * size**2:
                continue
            model = pin.Model(robot.model)
            model.gravity.linear = direction
            other = replace(robot, model=model)
            nats = _total(torque_scores(other, motion)) - given
            tried[tuple(float(x) for x in direction)] = nats
    best = max(tried, key=tried.__getitem__)
    words = (
        f"Gravity points along {listed(now, '.3g')} in the robot file; along "
        f"{listed(best, '.3g')} m/s^2 the torques fit better by {tried[best]:.0f} "
        "nats: is the base mounted like that?"
    )
    # A tilted base or a steady pull on the tool can look like that: never certain.
    return tried[best], Fault("robot_file", (), False, words)
