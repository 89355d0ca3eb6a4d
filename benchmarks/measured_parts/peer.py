"""The peer: a plain least-squares fit of the usual complete robot model.

tau = Y theta + Jr qdd + Fv qd + Fc sign(qd) + offset: full inertial regressor of all
links and four parameters per joint. Filter, edges and error are those of the diagnosis;
no mask, no prior and no knowledge of the robot but its kinematics.
"""

import numpy as np

from residual.recording import Recording
from residual.robot.dynamics import regressor
from residual.robot.robot import Robot
from residual.signals.track import Filters, Track, prepare

Array = np.ndarray

# Singular values of the normalised columns below this share are not identified.
_RANK = 1e-6
# The bar is on the ordinary fit, which is what "plain least squares" means. One round
# of weighting by each joint's residual makes a stronger peer on the logs of KR300: its
# ratio is reported beside the bar, and so is that of six separate fits.
VARIANTS = ("ordinary", "weighted", "per joint")


def peer_errors(
    robot: Robot, fit: list[Recording], held_out: list[Recording]
) -> dict[str, Array]:
    """Return the filtered error of each variant on the held-out logs.

    100 ||tau - tau_hat|| / ||tau|| per joint, both sides filtered, edges dropped.

    Args:
        robot: The robot; only its kinematics matter.

    Returns:
        Per variant the error of each joint [%]. Shape (dof,).
    """
    tracks, speed_floor = prepare(fit, Filters())
    proof, _ = prepare(held_out, Filters(), speed_floor, full_rate=True)
    x, tau = _rows(robot, tracks)
    x_proof, tau_proof = _rows(robot, proof)
    errors = {}
    for variant in VARIANTS:
        theta = _fit(x, tau, variant)
        miss = tau_proof - np.einsum("njp,jp->nj", x_proof, theta)
        errors[variant] = 100 * _norm(miss) / _norm(tau_proof)
    return errors


def _rows(robot: Robot, tracks: tuple[Track, ...]) -> tuple[Array, Array]:
    """Return filtered columns (n, dof, p) and torque (n, dof) outside the edges."""
    columns, torque = [], []
    for track in tracks:
        y = regressor(robot.model, track.q, track.qd, track.qdd)
        ones = np.ones_like(track.q)
        each = (track.qdd, track.qd, np.sign(track.qd), ones)
        own = [values[:, :, None] * np.eye(robot.dof) for values in each]
        filtered = track.filter(np.concatenate([y, *own], axis=2))
        columns.append(filtered[track.inner])
        torque.append(track.tau[track.inner])
    return np.concatenate(columns), np.concatenate(torque)


def _fit(x: Array, tau: Array, variant: str) -> Array:
    """Return the parameters that each joint is predicted with. Shape (dof, p)."""
    dof = tau.shape[1]
    if variant == "per joint":
        return np.array([_solve(x[:, j], tau[:, j]) for j in range(dof)])
    theta = _solve(x.reshape(-1, x.shape[2]), tau.ravel())
    if variant == "weighted":
        spread = (tau - x @ theta).std(axis=0)
        scaled = (x / spread[:, None]).reshape(-1, x.shape[2])
        theta = _solve(scaled, (tau / spread).ravel())
    return np.tile(theta, (dof, 1))


def _solve(x: Array, tau: Array) -> Array:
    size = np.linalg.norm(x, axis=0)
    size[size == 0] = 1.0
    return np.linalg.lstsq(x / size, tau, rcond=_RANK)[0] / size


def _norm(values: Array) -> Array:
    return np.linalg.norm(values, axis=0)
