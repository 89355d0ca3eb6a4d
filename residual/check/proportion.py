"""One torque that is out of proportion to those of the other joints.

A body moves all joints: what a rough robot file leaves open of it is one and the same
in the torques of all of them. A factor on the whole torque of one joint, its weight,
inertia and friction alike, contradicts the others.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from residual.check.columns import OUTER, Columns, columns
from residual.check.motion import Motion
from residual.check.result import Fault
from residual.check.rules import CHECK
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
