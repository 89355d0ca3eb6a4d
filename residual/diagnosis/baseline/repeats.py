"""How well a baseline repeats: what each of its logs would blame on the others' model.

Nothing changed between them, so all of it is the model's form: friction that has
another curve, a gear that twists. It comes back in every log, beyond any noise.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from residual.diagnosis.candidates import every_candidate
from residual.diagnosis.examine import Examined
from residual.diagnosis.habit import Habit
from residual.evidence.design import AMPLITUDE, Design, Group
from residual.evidence.fit import System, scaled_inverse
from residual.evidence.priors import POSTERIOR_FLOOR
from residual.evidence.screen import overlap, pulls, stacks
from residual.model.nominal import Nominal
from residual.recording import Array

POOLED = 3.0  # logs that the other joints' unrest counts as, beside a joint's own
UNTRIED = 2.0  # excess where one log alone cannot tell how logs differ
FLAT = 1e-9


def habits(first: Examined, learnt: Nominal) -> Mapping[tuple, Sequence[Habit]]:
    """What a baseline knows of each candidate that its model has not.

    Args:
        first: The diagnosis of the baseline.
        learnt: The model that it made.

    Returns:
        For each candidate's key one entry for each of its shapes.
    """
    design, logs = first.task.design, first.logs
    known = every_candidate(design, learnt, logs.span, logs.clock is not None)
    groups = known.groups
    parts = np.array_split(np.arange(design.folds), min(design.folds, _count(design)))
    ratios = np.array([_ratios(first, groups, part) for part in parts])
    excess = _excess(groups, ratios.mean(axis=0), len(parts))
    if len(logs.tracks) == 1:
        excess = np.maximum(excess, UNTRIED)
    seen = _had(first, groups, excess)
    out: dict[tuple, list[Habit]] = defaultdict(list)
    for group, more, (theta, covariance) in zip(groups, excess, seen, strict=True):
        out[group.key].append(Habit(group.shape, float(more), theta, covariance))
    return out


def _had(first: Examined, groups: Sequence[Group], excess: Array) -> list[tuple]:
    """Coefficients that the arm had of each candidate, and their covariance.

    Beforehand they are of the size of the tables; nothing for an arm without.
    """
    task, fitted = first.task, first.fit
    design = task.design
    weight = fitted.weight(design.rows)
    system = System.of(design, task.prior, fitted.members)
    theta, lower = system.solve(weight)
    shared = overlap(design, system, weight)
    pull = pulls(design, weight) - theta @ shared
    half = solve_triangular(lower, shared, lower=True)
    usual = np.array([design.usual(j) for j in range(design.dof)])
    out: list[tuple] = [()] * len(groups)
    for stack in stacks(design, groups):
        members, ids = stack.members, stack.ids
        information = stack.beyond(weight, half)
        for i, own, columns in zip(members, information, ids, strict=True):
            out[i] = _one_had(groups[i], own, pull[columns], (usual, excess[i]))
    return out


def _one_had(group: Group, information: Array, pull: Array, how) -> tuple:
    usual, excess = how
    size = float(usual[list(group.effect.rows(group.joints, len(usual)))].mean())
    nothing = np.zeros(len(group.ids))
    if size == 0:
        return nothing, np.diag(nothing)
    less = 1 / (1 + excess)
    precision = less * information + group.precision * (AMPLITUDE / size) ** 2
    covariance = scaled_inverse(precision)
    return covariance @ (less * pull), covariance


def _count(design: Design) -> int:
    """Parts that the baseline is held against itself in: its logs, or blocks of one."""
    return max(len(design.states), 3)


def _ratios(first: Examined, groups: Sequence[Group], folds: Array) -> Array:
    """Squared pull of one part on every candidate, over what noise gives. (g,)."""
    task, fitted = first.task, first.fit
    design = task.design
    weight = fitted.weight(design.rows)
    others = np.setdiff1d(np.arange(design.folds), folds)
    rest, own = design.part(others), design.part(folds)
    before = System.of(rest, task.prior, fitted.members)
    theta, lower = before.solve(weight)
    covariance = np.linalg.inv(lower @ lower.T)
    system = System.of(own, task.prior, fitted.members)
    precision = scaled_inverse(covariance + _floor(first, theta))
    precision += np.einsum("j,jmn->mn", weight, system.gram)
    shared = overlap(own, system, weight)
    pull = pulls(own, weight) - theta @ shared
    factor = cho_factor(precision, lower=True)
    pull -= cho_solve(factor, pull[system.ids]) @ shared
    half = solve_triangular(np.tril(factor[0]), shared, lower=True)
    out = np.empty(len(groups))
    for stack in stacks(own, groups):
        information = stack.beyond(weight, half)
        pulled = pull[stack.ids]
        out[stack.members] = _ratio(information, stack.precision, pulled)
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


def _excess(groups, ratios: Array, parts: int) -> Array:
    """Excess of each candidate, drawn towards that of its effect's other joints. (g,).

    Shapes are taken in their order: what is slow for one joint is slow for the next.
    """
    turn: Counter = Counter()
    kinds, places = defaultdict(list), []
    for group, ratio in zip(groups, ratios, strict=True):
        places.append((group.key[0], turn[group.key]))
        turn[group.key] += 1
        kinds[places[-1]].append(ratio)
    common = np.array([np.mean(kinds[place]) for place in places])
    drawn = (parts * ratios + POOLED * common) / (parts + POOLED)
    chance = (parts + POOLED) ** -0.5  # what so few logs scatter by
    return np.maximum(drawn - 1 - chance, 0.0)
