"""What the search and the gate would see of an effect of given size, on average.

Every figure is an expectation over the noise of a fit of these very logs: what an
effect adds to each joint's squared error after the nominal model has bent towards it,
in the fit and on logs left out of it, and what it costs to bend so far.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from residual.diagnosis.gate import left_out
from residual.diagnosis.search import Task
from residual.evidence.design import Group
from residual.evidence.fit import Fit, Prior, System, fit, scaled_inverse
from residual.evidence.rules import RULES
from residual.recording import Array


@dataclass(frozen=True, eq=False, slots=True)
class Bench:
    """A fit of the logs under several priors, ready to be asked about effects."""

    task: Task  # data, chosen prior, candidates and rules
    fitted: Fit  # the fit to which an effect would come
    # Its normal equations under each prior, the chosen one first.
    systems: tuple[System, ...]
    inverses: Array  # posterior covariances of those, (priors, m, m)
    scores: tuple[float, ...]  # evidence of the fit under each prior [nats]
    others: Array  # covariance under the chosen prior without each fold, (folds, m, m)
    grams: Array  # gram of the fit on each fold, (folds, dof, m, m)
    left: Array  # squared error of all folds, each predicted from the others, (dof,)

    @classmethod
    def of(cls, task: Task, fitted: Fit, priors: Sequence[Prior]) -> "Bench":
        """Solve once what all effects have in common."""
        design = task.design
        every, scores = _near(task, fitted, priors)
        systems = [System.of(design, p, fitted.members) for p in every]
        weight = fitted.weight(design.rows)
        whole, grams = systems[0], [own.gram for own in systems[0].folds(design)]
        others = [
            _covariance(replace(whole, gram=whole.gram - own), weight) for own in grams
        ]
        return cls(
            task,
            fitted,
            tuple(systems),
            np.stack([_covariance(s, weight) for s in systems]),
            tuple(scores),
            np.stack(others),
            np.stack(grams),
            left_out(task, fitted, whole).sum(axis=0),
        )

    @property
    def weight(self) -> Array:
        """Information of a unit of squared error [1 / N^2 m^2]. Shape (dof,)."""
        return self.fitted.weight(self.task.design.rows)


@dataclass(frozen=True, eq=False, slots=True)
class Expected:
    """What an effect in one direction of its coefficients does, per unit squared."""

    # Squared error that it adds to each joint after a refit without it, under each
    # prior, (priors, dof).
    fall: Array
    bent: Array  # prior energy of that refit under each prior, (priors,)
    occam: Array  # occam factor of its coefficients under each prior [nats], (priors,)
    held: float  # its own prior energy
    # Squared error that it adds to each fold predicted from the others, under the
    # chosen prior, (folds, dof).
    out: Array
    torque: Array  # its own mean square torque, in shares of rms squared, (dof,)
    count: int  # number of its coefficients
    cost: float  # price of the choice [nats]


def expected(bench: Bench, group: Group, directions: Sequence[Array]) -> list[Expected]:
    """What a group does in each of some directions."""
    task, design, weight = bench.task, bench.task.design, bench.weight
    own, mixed = _blocks(bench, group)
    every, across = own.sum(axis=0), mixed.sum(axis=0)  # over folds
    pull = np.tensordot(weight, across, 1)
    moved = bench.inverses @ pull
    # A prior bends the fit; what it leaves is the data's own affair.
    falls = _added(bench.systems[0].gram, every, across, moved[:, None])
    precisions = np.stack([system.precision for system in bench.systems])
    bends = moved.transpose(0, 2, 1) @ precisions @ moved
    known = np.tensordot(falls, weight, (1, 0)) + bends
    log_det = np.linalg.slogdet(known + group.precision)[1]
    without = bench.others @ (pull - np.tensordot(mixed, weight, (1, 0)))
    outs = _added(bench.grams, own, mixed, without[:, None])
    occam = 0.5 * np.maximum(log_det - group.log_det, 0.0)
    return [
        Expected(
            fall=_along(falls, u),
            bent=np.einsum("k,pkl,l->p", u, bends, u),
            occam=occam,
            held=float(u @ group.precision @ u),
            out=_along(outs, u),
            torque=_along(every, u) / design.rows / design.rms**2,
            count=len(group.ids),
            cost=task.candidates.cost(group),
        )
        for u in directions
    ]


def found(bench: Bench, one: Expected, sizes: Array) -> Array:
    """Whether effects of some sizes are found, if the noise does as on average.

    The estimate of the size is the one thing that chance moves; every rule below rises
    with it, so what holds at the average holds in half of the draws.

    Args:
        sizes: Its sizes. Shape (s,).

    Returns:
        Shape (s,), bool.
    """
    fitted, rules = bench.fitted, bench.task.rules
    square = np.asarray(sizes)[:, None] ** 2
    fall = square[..., None] * one.fall
    rise = np.log1p(fall / np.maximum(fitted.sse, 1e-300))
    spared = 0.5 * square * one.bent
    lost = 0.5 * rise @ fitted.counted + spared  # by the fit without it
    paid = one.occam + 0.5 * square * one.held - 0.5 * one.count
    net = lost - paid - one.cost
    scores = np.array(bench.scores)
    named = scores - paid - one.cost - RULES.per_name
    others = np.max(scores - lost, axis=1, keepdims=True)
    wins = (net >= rules.threshold) & (named >= others)
    by_fit = _lowers(bench, fall) & _confirmed(bench, one, square)
    big = np.sqrt(square * one.torque).max(axis=1, keepdims=True) >= rules.size
    spares = (net >= rules.plausible) & (spared >= rules.bent * net) & big
    return np.any(wins & (by_fit | spares), axis=1)


def _lowers(bench: Bench, fall: Array) -> Array:
    """Whether the error falls by enough under each prior. Shape (sizes, priors)."""
    design, rules = bench.task.design, bench.task.rules
    relative = np.sqrt(fall / design.rows) / design.rms
    share = fall / np.maximum(bench.fitted.sse + fall, 1e-300)
    return rules.lower(relative, share).any(axis=2)


def _confirmed(bench: Bench, one: Expected, square: Array) -> Array:
    """Whether logs left out are predicted better by enough, and enough of them.

    Args:
        square: Squares of its sizes. Shape (sizes, 1).

    Returns:
        Shape (sizes, 1).
    """
    fitted, design, rules = bench.fitted, bench.task.design, bench.task.rules
    acts = one.torque > 0
    # What its coefficients catch of the noise makes it predict worse.
    caught = one.count / max(acts.sum(), 1) * fitted.sse / fitted.counted
    fall = np.maximum(square * one.out.sum(axis=0) - acts * caught, 0)
    power = np.maximum(design.tau_power.sum(axis=0), 1e-30)
    share = fall / np.maximum(bench.left + fall, 1e-300)
    enough = rules.lower(np.sqrt(fall / power), share)
    # A fold is better with it by a normal chance of this many standard deviations.
    sure = np.sqrt(square[..., None] * np.maximum(one.out, 0) * bench.weight)
    folds = one.out > 1e-3 * np.maximum(one.out.max(axis=0), 1e-300)
    better = np.where(folds, ndtr(0.5 * sure), 0).sum(axis=1)
    better = better / np.maximum(folds.sum(axis=0), 1)
    return np.any(enough & (better >= RULES.most_folds), axis=1, keepdims=True)


def _near(task: Task, fitted: Fit, priors: Sequence[Prior]) -> tuple[list, list]:
    """The chosen prior and those that the search could turn to, with their evidence."""
    design, every = task.design, [task.prior, *priors]
    scores = [
        fit(design, p, fitted.members, fitted.counted, rounds=4).score for p in every
    ]
    near = [
        i for i, s in enumerate(scores) if i == 0 or s > max(scores) - RULES.hopeless
    ]
    return [every[i] for i in near], [scores[i] for i in near]


def _covariance(system: System, weight: Array) -> Array:
    return scaled_inverse(
        system.precision + np.einsum("j,jmn->mn", weight, system.gram)
    )


def _blocks(bench: Bench, group: Group) -> tuple[Array, Array]:
    """Gram of a group and with the fit, per fold and joint.

    Returns:
        Shapes (folds, dof, k, k), (folds, dof, m, k).
    """
    design, ids = bench.task.design, bench.systems[0].ids
    shape, k = (design.folds, design.dof), len(group.ids)
    own, mixed = np.zeros((*shape, k, k)), np.zeros((*shape, len(ids), k))
    for j in range(design.dof):
        place, mine = design.present(j, group.ids)
        if len(place):
            theirs, have = design.present(j, ids)
            gram = design.gram[j]
            own[:, j, mine[:, None], mine] = gram[:, place[:, None], place]
            mixed[:, j, have[:, None], mine] = gram[:, theirs[:, None], place]
    return own, mixed


def _added(gram: Array, own: Array, mixed: Array, moved: Array) -> Array:
    """Squared error of a group less what the moved fit imitates. Shape (..., k, k).

    Args:
        gram: Of the fit. Shape (..., m, m).
        own: Of the group. Shape (..., k, k).
        mixed: Of the fit with the group. Shape (..., m, k).
        moved: What the fit moves by. Shape (..., m, k).
    """
    turned = np.swapaxes(moved, -1, -2)
    across = turned @ mixed
    return own - across - np.swapaxes(across, -1, -2) + turned @ (gram @ moved)


def _along(form: Array, u: Array) -> Array:
    """Quadratic forms along a direction. Shape (...) of (..., k, k)."""
    return np.maximum(np.einsum("k,...kl,l->...", u, form, u), 0)
