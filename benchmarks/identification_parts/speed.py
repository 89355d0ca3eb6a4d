"""Time of the normal equations and of a robust fit, against a named peer.

The first are the program's: the regressor of 60 000 samples, and the triangular factor
of each joint's rows, by which identification keeps their sums.
"""

from time import process_time

import numpy as np
import pinocchio as pin
from sklearn.linear_model import HuberRegressor

from benchmarks.harness.figures import Figures, figure
from benchmarks.harness.rates import in_turn
from benchmarks.identification_parts.recovery import ROBOT, plant_logs
from residual.identification import estimate
from residual.identification.estimate import Options, Start, estimated
from residual.identification.identify import identify
from residual.identification.structure import Rows, rows_of
from residual.robot.base_parameters import base_columns
from residual.robot.dynamics import inverse_dynamics, regressor

SAMPLES = 60_000


def speed_figures(quick: bool) -> Figures:
    """Time the sums of 60 000 samples, and a Huber fit, in turn with their peers."""
    rounds = 2 if quick else 9
    motion = tuple(np.random.default_rng(1).uniform(-2, 2, (3, SAMPLES, ROBOT.dof)))
    tau = inverse_dynamics(ROBOT.model, *motion)
    base = base_columns(ROBOT.model)
    ours, loop = in_turn(
        rounds, lambda: _sums(motion, tau, base), lambda: _pinocchio_loop(motion, tau)
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


def _sums(motion: tuple, tau: np.ndarray, base: np.ndarray) -> estimate.Blocks:
    whole = regressor(ROBOT.model, *motion)
    x = tuple(whole[:, j, base] for j in range(ROBOT.dof))
    return estimate.compress(Rows(x, tuple(tau.T), (None,) * ROBOT.dof))


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
