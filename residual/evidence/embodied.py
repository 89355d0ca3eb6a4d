"""A fit with bodies that can exist, and what that costs: alone, as two verbs need it.

What logs do not tell of a body is moved first, at no price in torque (``nearest``).
Where the logs themselves contradict every possible body beyond chance, the fit says of
bodies what is not of bodies: then none is named (``Embodied.contradicted``).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtrc

from residual.errors import listed
from residual.evidence.design import Design
from residual.evidence.fit import BODY, Fit, scaled_inverse
from residual.evidence.thresholds import THRESHOLDS
from residual.model.bodies import BodyCorrection, bodies_of, nearest
from residual.model.model import Model
from residual.recording import Array

LITTLE = 0.01  # per cent of torque: less is not told


@dataclass(frozen=True, eq=False, slots=True)
class PossibleModel:
    """A model whose links and load can exist."""

    model: Model  # the model
    # What could not exist as fitted freely; None where every body can.
    correction: BodyCorrection | None
    # Whether the logs contradict every possible body: beyond chance, and on some joint
    # by as much as a name must explain.
    contradicted: bool = False

    @property
    def notes(self) -> tuple[str, ...]:
        """What was moved, and its price; nothing where every body can exist."""
        if self.correction is None:
            return ()
        cost = 100 * max(*self.correction.price, 0.0)
        more = f"{cost:.2g} %" if cost >= LITTLE else f"under {LITTLE:g} %"
        return (
            "the unconstrained fit gives physically impossible inertias for "
            f"{listed(self.correction.bodies)}: the model uses the nearest possible "
            "ones (positive definite pseudo-inertia), which raise the torque error of "
            f"a joint by {more} at most",
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """What no arm can be, in a sentence; nothing where that may be chance."""
        if self.correction is None or not self.contradicted:
            return ()
        return (
            "the logs give physically impossible inertias for "
            f"{listed(self.correction.bodies)}: check gravity, signs, units, the order "
            "of the joints and external forces on the arm",
        )


@dataclass(frozen=True, eq=False, slots=True)
class SeparateTerm:
    """A term that was fitted apart from the rest."""

    covariance: Array  # of its coefficients, (k, k)
    columns: tuple[Array, ...]  # its torque on the rows of each joint, (rows, k)


def with_possible_bodies(
    design: Design, fitted: Fit, model: Model, beside: Sequence[SeparateTerm] = ()
) -> PossibleModel:
    """Move a fitted model to the nearest one whose bodies can exist.

    Args:
        fitted: The fit that the model is of.
        model: It, as a model; behind the fit's coefficients those of ``beside``.
    """
    best = model.coefficients()
    bodies = bodies_of(model)
    impossible = bodies.impossible(best)
    if not impossible:
        return PossibleModel(model, None)
    apart = [np.linalg.cholesky(scaled_inverse(b.covariance)).T for b in beside]
    nearest_theta = nearest(bodies, best, block_diag(fitted.cholesky.T, *apart))
    before, after = (
        _mean_squares(design, fitted, beside, gap)
        for gap in (np.zeros(len(best)), nearest_theta - best)
    )
    price = (np.sqrt(after) - np.sqrt(before)) / design.rms
    # Twice the fall of log likelihood is chi-square of what the bodies can be moved by.
    fall = float(fitted.weight(design.rows) @ (design.rows * (after - before)))
    chance = float(chdtrc(BODY * len(impossible), max(fall, 0.0)))
    correction = BodyCorrection(impossible, tuple(float(p) for p in price), chance)
    # No arm has quite the form of its model: what is less than a name does not count.
    large = THRESHOLDS.lower(
        price, 1 - np.sqrt(before / np.maximum(after, 1e-300))
    ).any()
    # Of so many bodies one is always the worst, as of links.
    sure = chance < THRESHOLDS.link_zero_chance
    return PossibleModel(
        model.with_coefficients(nearest_theta), correction, bool(large and sure)
    )


def _mean_squares(
    design: Design, fitted: Fit, beside: Sequence[SeparateTerm], gap: Array
) -> Array:
    """Mean square residual of each joint after a move [N^2 m^2]. (dof,)."""
    ends = np.cumsum([0, *(len(b.covariance) for b in beside)])[: len(beside)]
    own, *others = np.split(gap, len(fitted.ids) + ends)
    out = np.zeros(design.dof)
    for j in range(design.dof):
        left = design.residual(j, fitted.ids, fitted.theta + own)
        for term, change in zip(beside, others, strict=True):
            left = left - term.columns[j] @ change
        out[j] = np.mean(left**2) if len(left) else 0.0
    return out
