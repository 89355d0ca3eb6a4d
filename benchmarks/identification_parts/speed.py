"""Time of the normal equations and of a robust fit, against a named peer.

60 000 samples of six joints have a regressor of 173 MB, and most of the time goes into
touching that memory. Here a slab of it is made, used and overwritten.
"""

from dataclasses import dataclass
from time import process_time

import numpy as np
import pinocchio as pin
from sklearn.linear_model import HuberRegressor

from benchmarks.harness.figures import Figures, figure
from benchmarks.harness.rates import in_turn
from benchmarks.identification_parts.recovery import ROBOT, plant_logs
from residual.errors import InputError
from residual.identification import estimate
from residual.identification.estimate import Options, Start, estimated
from residual.identification.identify import identify
from residual.identification.structure import rows_of
from residual.recording import Array
from residual.robot.base_parameters import base_columns
from residual.robot.dynamics import PER_LINK, inverse_dynamics

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


SAMPLES = 60_000


def speed_figures(quick: bool) -> Figures:
    """Time the sums of 60 000 samples, and a Huber fit, in turn with their peers."""
    rounds = 2 if quick else 9
    motion = tuple(np.random.default_rng(1).uniform(-2, 2, (3, SAMPLES, ROBOT.dof)))
    tau = inverse_dynamics(ROBOT.model, *motion)
    ours, loop = in_turn(
        rounds,
        lambda: normal_equations(ROBOT.model, motion, tau),
        lambda: _pinocchio_loop(motion, tau),
    )
    return {
        "normal_equations_seconds": figure(ours, 1.5, rounds, samples=SAMPLES),
        "normal_equations_over_pinocchio_loop": figure(
            ours / loop,
            None,
            rounds,
            peer="a loop of Pinocchio into one stacked matrix",
        ),
        **_robust(rounds),
    }


def _robust(rounds: int) -> Figures:
    fit, _ = plant_logs(1)
    whole = process_time()
    found = identify(ROBOT, fit, options=Options("irls"))
    whole = process_time() - whole
    rows = rows_of(found.nominal, found.logs.tracks, found.base)
    blocks = estimate.compress(rows)
    start = Start(found.nominal_theta, np.ones(len(found.base)), found.preflight.free)
    # The peer knows one noise for all rows: it is given rows in units of it.
    weight = 1 / found.estimate.noise
    x = np.concatenate([w * x for w, x in zip(weight, rows.x, strict=True)])
    y = np.concatenate([w * y for w, y in zip(weight, rows.y, strict=True)])
    peer = HuberRegressor(epsilon=1.345, alpha=0.0, fit_intercept=False, max_iter=1000)
    ours, theirs = in_turn(
        rounds,
        lambda: estimated(rows, blocks, start, Options("irls")),
        lambda: peer.fit(x / np.linalg.norm(x, axis=0), y),
    )
    return {
        "identify_seconds": figure(whole, None, 1, what="three logs of 15 s at 250 Hz"),
        "irls_over_sklearn_huber": figure(
            ours / theirs, None, rounds, rows=len(y), columns=x.shape[1]
        ),
    }


def _pinocchio_loop(motion: tuple, tau: np.ndarray) -> tuple:
    """The usual way: every regressor into one tall matrix, then its products."""
    model, data = ROBOT.model, ROBOT.model.createData()
    columns, dof = base_columns(model), model.nv
    tall = np.empty((dof * len(tau), 10 * dof))
    for i, (q, qd, qdd) in enumerate(zip(*motion, strict=True)):
        own = pin.computeJointTorqueRegressor(model, data, q, qd, qdd)
        tall[dof * i : dof * i + dof] = own
    base = tall[:, columns]
    return base.T @ base, base.T @ tau.ravel()
