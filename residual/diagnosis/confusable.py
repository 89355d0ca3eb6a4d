"""Which effects these logs could not tell apart, before anything is found in them.

It rests on the motion and on the noise alone: what a fit with one effect leaves of
another, in nats.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_triangular

from residual.diagnosis.gate import CLASS
from residual.diagnosis.result import Place
from residual.diagnosis.search import Task
from residual.evidence.design import Group
from residual.evidence.fit import Fit, System
from residual.evidence.screen import beyond, overlap, stacks
from residual.recording import Array

FLAT = 1e-9  # of the largest information of a group: a direction that does nothing


def lookalikes(
    task: Task, fitted: Fit, effects: Sequence[tuple[Group, Array]]
) -> list[tuple[Place, ...]]:
    """Candidates that would explain each effect within 6 nats.

    The nominal model bends with them. Of several shapes of a candidate the best counts;
    effects on all joints at once are left out.

    Args:
        task: Data, prior and candidates.
        fitted: The fit to which the effects would come.
        effects: Each with its coefficients. Shapes (k,).

    Returns:
        Their places for each effect, nearest first.
    """
    design = task.design
    weight = fitted.weight(design.rows)
    system = System.of(design, task.prior, fitted.members)
    shared = overlap(design, system, weight)
    half = solve_triangular(system.solve(weight)[1], shared, lower=True)
    others = [g for g in task.candidates.groups if not g.parts]
    bases = [
        ([others[i] for i in members], ids, _root(beyond(design, weight, ids, half)))
        for members, ids in stacks(others)
    ]
    out = []
    for group, theta in effects:
        pull = _seen(task, group, theta, weight) - half.T @ (half[:, group.ids] @ theta)
        every = theta @ pull[group.ids]
        lost: dict[tuple, float] = {}
        for members, ids, root in bases:
            caught = np.square(np.einsum("gij,gi->gj", root, pull[ids])).sum(axis=1)
            for other, part in zip(members, caught, strict=True):
                key = (other.effect.name, other.joints)
                lost[key] = min(lost.get(key, np.inf), 0.5 * float(every - part))
        own = (group.effect.name, group.joints)
        near = sorted((x, key) for key, x in lost.items() if x < CLASS and key != own)
        out.append(tuple(Place(n, tuple(j + 1 for j in js)) for _, (n, js) in near))
    return out


def _seen(task: Task, group: Group, theta: Array, weight: Array) -> Array:
    """Weighted products of an effect's torque with all columns. Shape (size,)."""
    design, out = task.design, np.zeros(task.design.size)
    for j in range(design.dof):
        place, have = design.present(j, group.ids)
        every = np.flatnonzero(design.place[j] >= 0)
        gram = design.total(j)[0][np.ix_(design.place[j][every], place)]
        out[every] += weight[j] * gram @ theta[have]
    return out


def _root(information: Array) -> Array:
    """Matrices R with R R' the inverse of each, flat directions out. (g, k, k)."""
    size = np.sqrt(np.maximum(np.diagonal(information, axis1=1, axis2=2), 1e-300))
    scaled = information / size[:, :, None] / size[:, None, :]
    values, vectors = np.linalg.eigh(scaled)
    real = values > FLAT * np.maximum(values.max(axis=1, keepdims=True), 1e-300)
    root = np.where(real, 1 / np.sqrt(np.maximum(values, 1e-300)), 0.0)
    return vectors * root[:, None, :] / size[:, :, None]
