"""A quick look at every candidate at once, and what it shares with a fit."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_triangular

from residual.evidence.design import Design, Group
from residual.evidence.fit import Fit, System
from residual.recording import Array


def screen(design: Design, base: Fit, groups: Sequence[Group], system: System) -> Array:
    """Quadratic evidence gain of every group on top of a fit [nats]. Shape (g,).

    Noise is held at the fit's own, rows at a quarter of their number or more:
    optimistic, so that nothing worth an exact look is lost. Groups of one shape go as
    one stack.

    Args:
        design: The columns.
        base: The fit.
        groups: The candidates.
        system: Normal equations of the fit.
    """
    weight = np.maximum(0.25, base.counted / design.rows) / base.variance
    theta, lower = system.solve(weight)
    shared = overlap(design, system, weight)
    pull = pulls(design, weight) - theta @ shared
    half = solve_triangular(lower, shared, lower=True, check_finite=False)
    out = np.empty(len(groups))
    for members, ids in stacks(groups):
        c = np.stack([groups[i].precision for i in members])
        c = c + beyond(design, weight, ids, half)
        log_det = np.array([groups[i].log_det for i in members])
        out[members] = _quadratic(c, pull[ids], log_det)
    return out


def pulls(design: Design, weight: Array) -> Array:
    """Weighted products of the target with all columns. Shape (size,)."""
    out = np.zeros(design.size)
    for j in range(design.dof):
        every = np.flatnonzero(design.place[j] >= 0)
        out[every] += weight[j] * design.total(j)[1][design.place[j][every]]
    return out


def overlap(design: Design, system: System, weight: Array) -> Array:
    """Weighted products of a fit's columns with all columns. Shape (m, size)."""
    out = np.zeros((len(system.ids), design.size))
    for j in range(design.dof):
        _, have = design.present(j, system.ids)
        every = np.flatnonzero(design.place[j] >= 0)
        rows, columns = design.place[j][system.ids[have]], design.place[j][every]
        out[np.ix_(have, every)] += (
            weight[j] * design.total(j)[0][np.ix_(rows, columns)]
        )
    return out


def beyond(design: Design, weight: Array, ids: Array, half: Array) -> Array:
    """Information of groups of columns that a fit cannot imitate. (g, k, k).

    Args:
        design: The columns.
        weight: Information of a unit of squared error of each joint. Shape (dof,).
        ids: Columns of groups of equal size. Shape (g, k).
        half: ``overlap`` by the lower factor of the fit's precision. (m, size).
    """
    own = half[:, ids].transpose(1, 0, 2)
    return _information(design, weight, ids) - own.transpose(0, 2, 1) @ own


def stacks(groups: Sequence[Group]) -> list[tuple[Array, Array]]:
    """Groups of as many columns on the same joints: their indices and columns."""
    alike: dict[tuple, list[int]] = {}
    for i, g in enumerate(groups):
        alike.setdefault((len(g.ids), g.effect.scope, g.joints), []).append(i)
    return [(np.array(m), np.stack([groups[i].ids for i in m])) for m in alike.values()]


def _information(design: Design, weight: Array, ids: Array) -> Array:
    """Weighted Gram of each row of columns. Shape (g, k, k) from (g, k)."""
    out = np.zeros((*ids.shape, ids.shape[1]))
    for j in range(design.dof):
        place = design.place[j][ids]
        have = place >= 0
        if have.any():
            gram, _ = design.total(j)
            block = gram[place[:, :, None], place[:, None, :]]
            out += weight[j] * block * (have[:, :, None] & have[:, None, :])
    return out


def _quadratic(c: Array, u: Array, log_det: Array) -> Array:
    """u'c^-1 u / 2 less the Occam factor, for stacks. Shape (g,)."""
    size = np.sqrt(np.maximum(np.diagonal(c, axis1=1, axis2=2), 1e-300))
    scaled = c / size[:, :, None] / size[:, None, :]
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, 1e-12)
    projected = np.einsum("gij,gi->gj", vectors, u / size)
    fit_part = 0.5 * np.sum(projected**2 / values, axis=1)
    log_c = np.log(values).sum(axis=1) + 2 * np.log(size).sum(axis=1)
    return fit_part - 0.5 * log_c + 0.5 * log_det
