"""How well a baseline repeats: what each of its logs would blame on the others' model.

Nothing changed between them, so all of it is the model's form: friction that has
another curve, a gear that twists. It comes back in every log, beyond any noise.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from residual.diagnosis.candidates import every_candidate
from residual.diagnosis.examine import Examined
from residual.evidence.design import Design, Group
from residual.evidence.fit import System, scaled_inverse
from residual.evidence.part import Part
from residual.evidence.priors import POSTERIOR_FLOOR
from residual.evidence.screen import beyond, overlap, stacks
from residual.model.nominal import Nominal
from residual.recording import Array

POOLED = 3.0  # logs that the other joints' unrest counts as, beside a joint's own
FLAT = 1e-9


def unrest(first: Examined, learnt: Nominal) -> Mapping[tuple, tuple[float, float]]:
    """How much more than noise each candidate shows between logs of the baseline.

    Args:
        first: The diagnosis of the baseline.
        learnt: The model that it made.

    Returns:
        For each candidate's key: evidence of one log in multiples of what noise gives,
        less one; and the rows of such a log on its joints.
    """
    design, logs = first.task.design, first.logs
    known = every_candidate(design, learnt, logs.span, logs.clock is not None)
    groups = known.groups
    parts = np.array_split(np.arange(design.folds), min(design.folds, _count(design)))
    ratios = np.array([_ratios(first, groups, part) for part in parts])
    return _by_key(groups, ratios.mean(axis=0), design, len(parts))


def _count(design: Design) -> int:
    """Parts that the baseline is held against itself in: its logs, or blocks of one."""
    return max(len(design.states), 3)


def _ratios(first: Examined, groups: Sequence[Group], folds: Array) -> Array:
    """Squared pull of one part on every candidate, over what noise gives. (g,)."""
    task, fitted = first.task, first.fit
    design = task.design
    weight = fitted.weight(design.rows)
    others = np.setdiff1d(np.arange(design.folds), folds)
    rest, own = Part(design, others), Part(design, folds)
    before = System.of(rest, task.prior, fitted.members)
    theta, lower = before.solve(weight)
    covariance = np.linalg.inv(lower @ lower.T)
    system = System.of(own, task.prior, fitted.members)
    precision = scaled_inverse(covariance + _floor(first, theta))
    precision += np.einsum("j,jmn->mn", weight, system.gram)
    pull = np.zeros(design.size)
    shared = overlap(own, system, weight)
    for j in range(design.dof):
        every = np.flatnonzero(design.place[j] >= 0)
        pull[every] += weight[j] * own.total(j)[1][design.place[j][every]]
    pull -= theta @ shared
    factor = cho_factor(precision, lower=True)
    pull -= cho_solve(factor, pull[system.ids]) @ shared
    half = solve_triangular(np.tril(factor[0]), shared, lower=True)
    out = np.empty(len(groups))
    for members, ids in stacks(groups):
        information = beyond(own, weight, ids, half)
        bound = np.stack([groups[i].precision for i in members])
        out[members] = _ratio(information, bound, pull[ids])
    return out


def _ratio(information: Array, bound: Array, pull: Array) -> Array:
    """Evidence of a pull in units of its expectation under noise. (g,)."""
    both = information + bound
    solved = np.linalg.solve(both, pull[:, :, None])[:, :, 0]
    square = np.einsum("gi,gi->g", pull, solved)
    counts = np.trace(np.linalg.solve(both, information), axis1=1, axis2=2)
    return np.where(counts > 0.1, square / np.maximum(counts, 0.1), 1.0)


def _floor(first: Examined, theta: Array) -> Array:
    """What no model is held to more closely than. Diagonal, (m, m)."""
    own = np.zeros(len(theta))
    model = first.nominal.model
    values = model.coefficients() + theta[: len(model.coefficients())]
    own[: len(values)] = values
    own[len(values) :] = theta[len(values) :]
    return np.diag((POSTERIOR_FLOOR * own) ** 2 + FLAT**2)


def _by_key(groups, ratios: Array, design: Design, parts: int) -> dict:
    """The loudest shape of each key, drawn towards its effect's other joints."""
    loudest: dict[tuple, tuple[float, Group]] = {}
    for group, ratio in zip(groups, ratios, strict=True):
        if ratio >= loudest.get(group.key, (-np.inf, group))[0]:
            loudest[group.key] = (float(ratio), group)
    kinds = defaultdict(list)
    for ratio, group in loudest.values():
        kinds[group.label or group.effect.name].append(ratio)
    out = {}
    for key, (ratio, group) in loudest.items():
        common = float(np.mean(kinds[key[0]]))
        drawn = (parts * ratio + POOLED * common) / (parts + POOLED)
        joints = group.effect.rows(group.joints, design.dof)
        rows = float(np.mean(design.rows[list(joints)])) / parts
        out[key] = (max(drawn - 1.0, 0.0), rows)
    return out
