"""Readings of time, of gravity and of single torques that suit the physics better."""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.linalg import cho_factor, cho_solve

from residual.check.motion import OUTER, Columns, Motion, columns
from residual.check.reading import Scores, torque_scores
from residual.check.result import Fault, Repair
from residual.check.rules import CHECK
from residual.names import listed
from residual.recording import Array
from residual.robot.dynamics import PER_LINK
from residual.robot.robot import Robot

_SCALES = np.geomspace(1 / 30, 30, 35)


@dataclass(frozen=True, eq=False, slots=True)
class _Part:
    """Sums of one joint's rows over the coefficients of all joints."""

    gram: Array
    model: Array
    torque: Array
    squares: tuple[float, float, float]  # torque^2, torque * model, model^2
    rows: float
    floor: float
    own: slice  # coefficients that are this joint's alone: its friction, its rotor


def out_of_proportion(robot: Robot, motion: Motion) -> tuple[float, Fault | None]:
    """Find the torque of one joint that fits the others only times a factor.

    Returns:
        What the factor gains [nats], and the fault; 0 and None where there is none.
    """
    parts = _parts(motion, columns(robot, motion))
    sigma = _sigma(parts)
    given = _evidence(parts, sigma, 0, 1.0)
    table = np.array(
        [[_evidence(parts, sigma, j, s) for s in _SCALES] for j in range(robot.dof)]
    )
    best = table.argmax(axis=1)
    gain = table.max(axis=1) - given
    # At an end of the scales it is a torque that says nothing, not a factor.
    gain[(best == 0) | (best == len(_SCALES) - 1)] = 0.0
    j = int(np.argmax(gain))
    if (
        gain[j] < CHECK.scale_worth
        or (np.delete(gain, j) > gain[j] - CHECK.scale_clearer).any()
    ):
        return 0.0, None
    words = (
        f"The torque of joint {j + 1} is out of proportion to the others: times about "
        f"{_SCALES[best[j]]:.2g} it fits the same body better by {gain[j]:.0f} nats."
    )
    return float(gain[j]), Fault("torque_scale", (j + 1,), False, words)


def _parts(motion: Motion, joints: list[Columns]) -> list[_Part]:
    """Own columns of each joint side by side, those of the body and outside common."""
    dof, out = len(joints), []
    common = OUTER + PER_LINK * dof
    own = [joint.values.shape[1] - common for joint in joints]
    starts = np.concatenate([[0], np.cumsum(own)])
    strongest = np.sqrt(np.mean(motion.tau**2, axis=0).max())
    for j, joint in enumerate(joints):
        values = np.zeros((len(joint.nominal), starts[-1] + common))
        values[:, starts[j] : starts[j + 1]] = joint.values[:, : own[j]]
        values[:, starts[-1] :] = joint.values[:, own[j] :]
        tau, model = motion.tau[joint.rows, j], joint.nominal
        pairs = ((tau, tau), (tau, model), (model, model))
        weight, rows = motion.spread, motion.spread * len(tau)
        squares = tuple(weight * float(a @ b) for a, b in pairs)
        size = np.sqrt(squares[0] / max(rows, 1e-9))
        floor = max(CHECK.scale_noise * size, CHECK.scale_coupled * strongest, 1e-12)
        sums = (weight * values.T @ x for x in (values, model, tau))
        own_columns = slice(int(starts[j]), int(starts[j + 1]))
        out.append(_Part(*sums, squares, rows, floor, own_columns))
    return out


def _sigma(parts: list[_Part]) -> Array:
    """What the common body leaves of each torque, by turns with its fit. (dof,)."""
    sigma = np.array([part.floor for part in parts])
    for _ in range(CHECK.rounds):
        _, at, _ = _fit(parts, sigma, np.ones(len(parts)))
        for j, part in enumerate(parts):
            power, cross, model = part.squares
            left = power - 2 * cross + model - 2 * at @ (part.torque - part.model)
            left = max(float(left + at @ part.gram @ at), 0.0)
            sigma[j] = max(np.sqrt(left / max(part.rows, 1e-9)), part.floor)
    return sigma


def _fit(parts: list[_Part], sigma: Array, scale: Array) -> tuple[float, Array, float]:
    """Quadratic form of the rest, coefficients, and log determinant.

    The friction of a joint grows with the factor on its torque, so it speaks neither
    for a factor nor against one: only what the joint shares with the others does.
    """
    prior, sums, square = np.ones(len(parts[0].gram)), 0.0, 0.0
    for part, s in zip(parts, scale, strict=True):
        prior[part.own] = s**-2.0
    gram = np.diag(prior)
    for part, sd, s in zip(parts, sigma * scale, scale, strict=True):
        power, cross, model = part.squares
        gram += part.gram / sd**2
        sums = sums + (s * part.torque - part.model) / sd**2
        square += (s**2 * power - 2 * s * cross + model) / sd**2
    factor = cho_factor(gram)
    at = cho_solve(factor, sums)
    size = 2 * float(np.log(np.diag(factor[0])).sum()) - float(np.log(prior).sum())
    return square - float(sums @ at), at, size


def _evidence(parts: list[_Part], sigma: Array, joint: int, factor: float) -> float:
    """Log evidence of all torques, one of them times a factor."""
    scale = np.ones(len(parts))
    scale[joint] = factor
    square, _, size = _fit(parts, sigma, scale)
    # Noise grows with the torque that it is a share of: no factor gains by its size.
    return -0.5 * (square + size)


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
