"""A quick look at every candidate at once, and what it shares with a fit."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

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
    """
    weight = np.maximum(0.25, base.counted / design.rows) / base.variance
    theta, lower = system.solve(weight)
    shared = overlap(design, system, weight)
    pull = pulls(design, weight) - theta @ shared
    half = solve_triangular(lower, shared, lower=True, check_finite=False)
    out = np.empty(len(groups))
    for stack in stacks(design, groups):
        c = stack.precision + stack.beyond(weight, half)
        own = _quadratic(c, pull[stack.ids] + stack.pull, stack.log_det)
        out[stack.members] = own - 0.5 * stack.level
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
        rows, have = system.present[j]
        every = np.flatnonzero(design.place[j] >= 0)
        columns = design.place[j][every]
        out[np.ix_(have, every)] += (
            weight[j] * design.total(j)[0][np.ix_(rows, columns)]
        )
    return out


@dataclass(frozen=True, eq=False, slots=True)
class Stack:
    """Groups of as many columns.

    Attributes:
        members: Their numbers among all groups. Shape (g,).
        ids: Their columns. Shape (g, k).
        gram: Of each by itself, joint by joint. Shape (dof, g, k, k).
        acts: The joints on which they act. Shape (g, dof), bool.
        precision: Their priors. Shape (g, k, k).
        pull, level: What is known for sure (``Given``). Shapes (g, k), (g,).
        log_det: Log determinants of these. Shape (g,).
    """

    members: Array
    ids: Array
    gram: Array
    acts: Array
    precision: Array
    pull: Array
    level: Array
    log_det: Array

    def beyond(self, weight: Array, half: Array) -> Array:
        """Information of the groups that a fit cannot imitate. Shape (g, k, k).

        Args:
            weight: Information of a unit of squared error of each joint. Shape (dof,).
            half: ``overlap`` by the lower factor of the fit's precision. (m, size).
        """
        own = half[:, self.ids].transpose(1, 0, 2)
        known = np.tensordot(weight, self.gram, 1)
        return known - own.transpose(0, 2, 1) @ own


def stacks(design: Design, groups: Sequence[Group]) -> list[Stack]:
    """Return groups, put together where they are alike; remembered by the design."""
    known = design.remembered
    if id(groups) not in known:
        alike: dict[int, list[int]] = {}
        for i, g in enumerate(groups):
            alike.setdefault(len(g.ids), []).append(i)
        # The groups are kept with them, so that nothing else can get their id.
        made = [_stack(design, groups, np.array(m)) for m in alike.values()]
        known[id(groups)] = groups, made
    return known[id(groups)][1]


def acting(design: Design, groups: Sequence[Group], joints: Iterable[int]) -> Array:
    """Which groups act on one of some joints. Shape (g,), bool."""
    out, on = np.zeros(len(groups), dtype=bool), sorted(joints)
    for stack in stacks(design, groups):
        out[stack.members] = stack.acts[:, on].any(axis=1)
    return out


def _stack(design: Design, groups: Sequence[Group], members: Array) -> Stack:
    own = [groups[i] for i in members]
    ids = np.stack([g.ids for g in own])
    grams = np.zeros((design.dof, *ids.shape, ids.shape[1]))
    acts = np.zeros((len(own), design.dof), dtype=bool)
    for j in range(design.dof):
        place = design.place[j][ids]
        have = place >= 0
        acts[:, j] = have.any(axis=1)
        some = np.flatnonzero(acts[:, j])
        block = design.total(j)[0][place[some][:, :, None], place[some][:, None, :]]
        grams[j, some] = block * (have[some][:, :, None] & have[some][:, None, :])
    priors = [g.prior for g in own]
    precision = np.stack(
        [g.precision + p.information for g, p in zip(own, priors, strict=True)]
    )
    pull, level = np.stack([p.pull for p in priors]), [p.level for p in priors]
    log_det = np.array([p.log_det for p in priors])
    return Stack(members, ids, grams, acts, precision, pull, np.array(level), log_det)


def _quadratic(c: Array, u: Array, log_det: Array) -> Array:
    """u'c^-1 u / 2 less the Occam factor, for stacks. Shape (g,)."""
    size = np.sqrt(np.maximum(np.diagonal(c, axis1=1, axis2=2), 1e-300))
    if c.shape[1] == 1:
        return 0.5 * (u[:, 0] / size[:, 0]) ** 2 - np.log(size[:, 0]) + 0.5 * log_det
    scaled = c / size[:, :, None] / size[:, None, :]
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, 1e-12)
    projected = np.einsum("gij,gi->gj", vectors, u / size)
    fit_part = 0.5 * np.sum(projected**2 / values, axis=1)
    log_c = np.log(values).sum(axis=1) + 2 * np.log(size).sum(axis=1)
    return fit_part - 0.5 * log_c + 0.5 * log_det
