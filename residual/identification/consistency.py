"""Full parameters that a body can have, nearest to the nominal among those that fit.

min  |R (K pi - theta)|^2 + (pi - pi_0)' S^-1 (pi - pi_0) / scale^2

over bodies that can exist (``residual.model.bodies``) and friction that brakes, with
R'R the information of the free fit about theta, so that whatever the logs tell weighs
as they tell it, and the rest stays near the nominal.
"""

from dataclasses import dataclass

import numpy as np

from residual.errors import InputError
from residual.identification.estimate import squares
from residual.identification.identify import Identification
from residual.model.bodies import bodies_of, least_eigenvalues, nearest
from residual.model.forward import POSES, least_mass_matrix
from residual.model.model import Model
from residual.recording import Array

LOOSE = 1.0  # relative doubt of nominal values that logs may override


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
        InputError: If the scale is no positive number, or the method fails.
    """
    if not 0 < scale < np.inf:
        raise InputError(
            f"Scale {scale:g}: expected a positive number; 1 doubts nominal values by "
            "their own size."
        )
    best, root = _unconstrained(found, scale)
    bodies = bodies_of(found.nominal.with_coefficients(best), friction=True)
    model = found.nominal.with_coefficients(nearest(bodies, best, root))
    return Consistent(
        model,
        least_eigenvalues(model),
        least_mass_matrix(model),
        POSES,
        _misfit(found, model),
    )


def _unconstrained(found: Identification, scale: float) -> tuple[Array, Array]:
    """Return the best parameters without the cone (s,), and U (s, s).

    With U'U the information of rows and nominal together, in SI units.
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
    return start + unit * np.linalg.solve(upper, target), upper / unit


def _misfit(found: Identification, model: Model) -> Array:
    theta = found.base.mapping @ model.coefficients()
    both = [squares(found.blocks, t) for t in (found.estimate.theta, theta)]
    return np.sqrt(np.array(both) / np.maximum(found.estimate.counts, 1))
