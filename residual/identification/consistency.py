"""Full parameters that a body can have, nearest to the nominal among those that fit.

A body's ten parameters belong to some distribution of positive mass if and only if its
pseudo-inertia is positive definite (Wensing, Kim, Slotine 2018; Sousa and Cortesao
2014 for the problem as a semidefinite program):

J_i = [[tr(I_i) / 2 - I_i, h_i], [h_i', m_i]] > 0,    h = m c, I about the link frame

min  |R (K pi - theta)|^2 + (pi - pi_0)' S^-1 (pi - pi_0) / scale^2

with R'R the information of the free fit about theta, so that whatever the logs tell
weighs as they tell it, and the rest stays near the nominal. The solver is Clarabel by
way of cvxpy (extra ``[sdp]``), loaded only here and only when it is needed.
"""

import warnings
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from residual.errors import InputError
from residual.identification.estimate import squares
from residual.identification.identify import Identification
from residual.model.model import Model
from residual.recording import Array
from residual.robot import dynamics
from residual.robot.robot import Robot

LOOSE = 1.0  # relative doubt of nominal values that logs may override
POSES = 10_000
_LEAST = 1e-4  # of the nominal link's own scale: how far inside the cone to stay
_FLOOR_SIZE = 0.05  # m: what a smaller link may have become with a tool on it
_FLOOR_MASS = 0.005  # of the arm's mass, likewise
_SOLVED = ("optimal", "optimal_inaccurate")


@dataclass(frozen=True, eq=False, slots=True)
class Consistent:
    """Physically consistent parameters.

    Attributes:
        model: The model that has them.
        least_eigenvalue: Smallest eigenvalue of each link's pseudo-inertia over that
            of its own scale, m and m r^2. Shape (dof,).
        least_mass_matrix: Smallest eigenvalue of M(q), rotors included, over all
            poses [kg m^2].
        poses: Poses at which it was looked at.
        misfit: Rms of each joint's rows, fitted freely and consistently [N m].
            Shape (2, dof).
    """

    model: Model
    least_eigenvalue: Array
    least_mass_matrix: float
    poses: int
    misfit: Array


def consistent(found: Identification, scale: float = LOOSE) -> Consistent:
    """Find the physically consistent parameters that fit, nearest to the nominal.

    Raises:
        InputError: If cvxpy or Clarabel is not installed, or nothing is feasible.
    """
    cp = solver()
    if not 0 < scale < np.inf:
        raise InputError(
            f"Scale {scale:g}: expected a positive number; 1 doubts nominal values by "
            "their own size."
        )
    best, across = _unconstrained(found, scale)
    excess = cp.Variable(len(best))
    value = best + across @ excess
    problem = cp.Problem(
        cp.Minimize(cp.sum_squares(excess)), _constraints(cp, found.nominal, value)
    )
    _solve(cp, problem)
    model = _checked(found.nominal.with_coefficients(best + across @ excess.value))
    return Consistent(
        model,
        least_eigenvalues(model),
        least_mass_matrix(model),
        POSES,
        _misfit(found, model),
    )


def solver() -> ModuleType:
    """Return cvxpy, made sure that Clarabel is there too.

    Raises:
        InputError: If one of them is not installed.
    """
    try:
        import clarabel  # noqa: F401  the solver that cvxpy is told to use
        import cvxpy
    except ImportError as error:
        raise InputError(
            f"Consistent parameters need {error.name}, which is not installed. Install "
            "the extra: pip install '.[sdp]' in the checkout."
        ) from error
    return cvxpy


def _unconstrained(found: Identification, scale: float) -> tuple[Array, Array]:
    """Return the best parameters without the cone (s,), and U^-1 in SI units (s, s).

    With A = U'U the information of rows and nominal together, parameters best +
    U^-1 e cost e'e more than the best: in e the solver sees a round bowl, whatever
    the units and however unequal the knowledge of single parameters.
    """
    estimate, start = found.estimate, found.nominal.coefficients()
    unit = np.sqrt(np.diag(found.spread))
    pairs = zip(estimate.weight, found.blocks, strict=True)
    rows = np.concatenate([np.sqrt(w) * block for w, block in pairs])
    left = rows[:, :-1] @ found.base.mapping * unit
    right = rows[:, -1] - rows[:, :-1] @ found.nominal_theta
    correlation = found.spread / np.outer(unit, unit)
    root = np.linalg.cholesky(np.linalg.inv(correlation)).T / scale
    both = np.concatenate([left, root])
    q, upper = np.linalg.qr(both)
    target = q.T @ np.concatenate([right, np.zeros(len(root))])
    inverse = np.linalg.inv(upper)
    return start + unit * (inverse @ target), unit[:, None] * inverse


def _constraints(cp: ModuleType, nominal: Model, value: Any) -> list:
    """Pseudo-inertias inside the cone, and effects that only ever brake positive."""
    out = []
    for link, scale in enumerate(link_scales(nominal.robot)):
        m, x, y, z, xx, xy, yy, xz, yz, zz = (value[10 * link + k] for k in range(10))
        half = (xx + yy + zz) / 2
        pseudo = cp.bmat(
            [
                [half - xx, -xy, -xz, x],
                [-xy, half - yy, -yz, y],
                [-xz, -yz, half - zz, z],
                [x, y, z, m],
            ]
        )
        inverse = np.diag(1 / scale)
        out.append(inverse @ pseudo @ inverse >> _LEAST * np.eye(4))
    place = len(nominal.inertial)
    for term in nominal.terms:
        if term.effect.not_negative:
            out.append(value[place : place + len(term.theta)] >= 0)
        place += len(term.theta)
    return out


def _solve(cp: ModuleType, problem: Any) -> None:
    try:
        with warnings.catch_warnings():
            # "May be inaccurate" is about the last digits; bodies are checked after.
            warnings.simplefilter("ignore")
            problem.solve(solver=cp.CLARABEL)
    except cp.error.SolverError as error:
        raise InputError(f"No consistent parameters: {error}") from error
    if problem.status not in _SOLVED:
        raise InputError(
            f"No consistent parameters: the problem is {problem.status}. Check units "
            "and signs of the logs, and the robot's masses."
        )


def _checked(model: Model) -> Model:
    """What the solver found, made sure that it is what was asked for."""
    least = least_eigenvalues(model)
    if least.min() <= 0:
        link = int(np.argmin(least)) + 1
        raise InputError(
            f"No consistent parameters: the solver left link {link} with an eigenvalue "
            f"of {least.min():.2g}, expected above 0. Take a smaller scale, nearer to "
            "the nominal, or longer logs."
        )
    return model


def link_scales(robot: Robot) -> Array:
    """Return the root of the size of each pseudo-inertia: sqrt(m) (r, 1). (dof, 4)."""
    out, bodies = [], list(robot.model.inertias)[1:]
    least = _FLOOR_MASS * sum(body.mass for body in bodies)
    for body in bodies:
        values = np.array(body.toDynamicParameters())
        spread = values[[4, 6, 9]].sum() / 2 / max(body.mass, 1e-9)
        radius = max(np.sqrt(max(spread, 0.0)), _FLOOR_SIZE)
        out.append(np.sqrt(max(body.mass, least)) * np.array([radius] * 3 + [1.0]))
    return np.array(out)


def pseudo_inertias(parameters: Array) -> Array:
    """Return J of every link. Shape (dof, 4, 4) from (10 dof,)."""
    out = []
    for m, x, y, z, xx, xy, yy, xz, yz, zz in np.reshape(parameters, (-1, 10)):
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        h = np.array([[x], [y], [z]])
        upper = np.trace(inertia) / 2 * np.eye(3) - inertia
        out.append(np.block([[upper, h], [h.T, np.array([[m]])]]))
    return np.array(out)


def least_eigenvalues(model: Model) -> Array:
    """Return the smallest eigenvalue of each scaled pseudo-inertia. Shape (dof,)."""
    scale = link_scales(model.robot)
    pseudo = pseudo_inertias(model.inertial)
    return np.linalg.eigvalsh(pseudo / scale[:, :, None] / scale[:, None, :])[:, 0]


def least_mass_matrix(model: Model, poses: int = POSES, seed: int = 0) -> float:
    """Return the least eigenvalue of M(q) [kg m^2], rotors included, over random poses.

    M is positive definite for every pose where it is for every one that was tried
    only in all likelihood; for consistent links it is proved.
    """
    robot, rng = model.robot, np.random.default_rng(seed)
    low = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    high = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    q = rng.uniform(low, high, (poses, robot.dof))
    body = dynamics.with_inertial_parameters(robot.model, model.inertial)
    matrices = dynamics.mass_matrix(body, q)
    for term in model.terms:
        if term.effect.carries == "acceleration":
            (joint,) = term.joints
            matrices[:, joint, joint] += term.theta[0]
    return float(np.linalg.eigvalsh(matrices)[:, 0].min())


def _misfit(found: Identification, model: Model) -> Array:
    theta = found.base.mapping @ model.coefficients()
    both = [squares(found.blocks, t) for t in (found.estimate.theta, theta)]
    return np.sqrt(np.array(both) / np.maximum(found.estimate.counts, 1))
