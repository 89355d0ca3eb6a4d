"""How well a motion excites the parameters of the rigid body.

W theta = tau stacks the base regressor over samples (G2017 eq. 6). Its columns are
brought to length one, so that neither units nor the size of a parameter count; the
condition number of what is left tells how much of the noise in tau can grow in theta
(Swevers et al. 1997, cited there). log det tells how much was learnt in all.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.linalg import eigh

from residual.recording import Array
from residual.robot.base_parameters import base_columns
from residual.robot.dynamics import regressor

_SHARP = 12  # power of the mean that stands for the extreme eigenvalues
_AMOUNT = 0.1  # weight of log det per parameter beside log condition
_FLOOR = 1e-13  # least eigenvalue that is told from zero


@dataclass(frozen=True, slots=True)
class Excitation:
    """What the samples of one motion tell about the base parameters.

    Attributes:
        condition: Condition number of the column-normalised base regressor W, inf
            where a parameter is not excited.
        log_det: log det(W' W / samples) of the regressor as it is, in SI units.
        parameters: Number of base parameters.
    """

    condition: float
    log_det: float
    parameters: int


def excitation(model: pin.Model, q: Array, qd: Array, qdd: Array) -> Excitation:
    """Return how well some samples excite the base parameters.

    Args:
        q: Positions [rad]. Shape (n, dof).
        qd: Velocities [rad/s]. Shape (n, dof).
        qdd: Accelerations [rad/s^2]. Shape (n, dof).
    """
    columns = base_columns(model)
    count = len(columns)
    stacked = regressor(model, q, qd, qdd)[:, :, columns].reshape(-1, count)
    size = np.linalg.norm(stacked, axis=0)
    if len(stacked) < count or size.min() == 0:
        return Excitation(float("inf"), float("-inf"), count)
    values = np.linalg.svd(stacked / size, compute_uv=False)
    if values[-1] <= _FLOOR * values[0]:
        return Excitation(float("inf"), float("-inf"), count)
    amount = 2 * np.log(values * size).sum() - count * np.log(len(q))
    return Excitation(float(values[0] / values[-1]), float(amount), count)


def cost(stacked: Array) -> tuple[float, Array]:
    """Return what a better motion makes smaller, and its gradient.

    log condition - 0.1 log det(W' W) / b. The extreme eigenvalues of the
    column-normalised C = D^-1 W' W D^-1 are replaced by power means, since the true
    ones have no gradient where two of them meet:

    log condition ~ (log mean l^p + log mean l^-p) / 2p, p = 12.

    Args:
        stacked: W, more rows than columns. Shape (rows, b).

    Returns:
        The cost and its derivative by every entry of W. Shape (rows, b).
    """
    count = stacked.shape[1]
    gram = stacked.T @ stacked
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = eigh(gram / np.outer(size, size))
    values = np.maximum(values, _FLOOR)
    high, low = values**_SHARP, (values[0] / values) ** _SHARP
    condition = np.log(high.mean()) + np.log(low.mean()) - _SHARP * np.log(values[0])
    amount = (np.log(values).sum() + 2 * np.log(size).sum()) / count
    slope = (high / high.sum() - low / low.sum()) / (2 * values)
    by_c = (vectors * slope) @ vectors.T
    inverse = (vectors / values) @ vectors.T / np.outer(size, size)
    # C depends on the gram matrix G through its own diagonal too:
    # df/dG = D^-1 S D^-1 - diag((S C)_cc / G_cc), S = df/dC.
    by_gram = by_c / np.outer(size, size)
    by_gram -= np.diag((vectors**2 @ (slope * values)) / size**2)
    by_gram -= _AMOUNT / count * inverse
    return condition / (2 * _SHARP) - _AMOUNT * amount, 2 * stacked @ by_gram
