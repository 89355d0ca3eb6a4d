"""Normal equations of the rigid body, without ever holding its whole regressor.

60 000 samples of six joints have a regressor of 173 MB, and most of the time goes into
touching that memory. Here a slab of it is made, used and overwritten.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.recording import Array
from residual.robot.dynamics import PER_LINK

_SLAB = 500  # samples; six joints of it stay in a cache of 2 MB


@dataclass(frozen=True, eq=False, slots=True)
class Normal:
    """Sums over samples, per joint: all that least squares needs of them.

    Attributes:
        gram: x_j' x_j. Shape (dof, p, p).
        cross: x_j' y_j. Shape (dof, p).
        power: y_j' y_j [N^2 m^2]. Shape (dof,).
        samples: How many samples.
    """

    gram: Array
    cross: Array
    power: Array
    samples: int


def normal_equations(
    model: pin.Model, motion: tuple[Array, Array, Array], tau: Array
) -> Normal:
    """Sum up the normal equations of all inertial parameters.

    Row j of the regressor has no entry of links before j; those columns are skipped.

    Args:
        motion: q, qd, qdd [rad, rad/s, rad/s^2]. Shape (n, dof) each.
        tau: Torque [N m]. Shape (n, dof).

    Returns:
        The sums; base parameters are a choice of rows and columns of them.

    Raises:
        InputError: If motion and torque differ in shape.
    """
    q, qd, qdd = (np.ascontiguousarray(x, dtype=float) for x in motion)
    tau = np.ascontiguousarray(tau, dtype=float)
    dof, size = model.nv, PER_LINK * model.nv
    for name, x in (("q", q), ("qd", qd), ("qdd", qdd), ("tau", tau)):
        if x.shape != (len(tau), dof):
            raise InputError(
                f"{name} has shape {x.shape}, expected {(len(tau), dof)}: one row per "
                "sample, one column per joint."
            )
    data = model.createData()
    slab = np.empty((dof, _SLAB, size + 1))
    sums = np.zeros((dof, size + 1, size + 1))
    for start in range(0, len(q), _SLAB):
        stop = min(start + _SLAB, len(q))
        for i in range(start, stop):
            slab[:, i - start, :size] = pin.computeJointTorqueRegressor(
                model, data, q[i], qd[i], qdd[i]
            )
        slab[:, : stop - start, size] = tau[start:stop].T
        for j in range(dof):
            own = slab[j, : stop - start, PER_LINK * j :]
            sums[j, PER_LINK * j :, PER_LINK * j :] += own.T @ own
    gram, cross = sums[:, :size, :size].copy(), sums[:, :size, size].copy()
    return Normal(gram, cross, sums[:, size, size].copy(), len(q))
