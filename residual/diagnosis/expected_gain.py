"""What the search and the gate would see of an effect of given size, on average.

Every figure is an expectation over the noise of a fit of these very logs: what an
effect adds to each joint's squared error after the nominal model has bent towards it,
in the fit and on logs left out of it, and what it costs to bend so far.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from residual.diagnosis.gate import MOST_FOLDS, left_out
from residual.diagnosis.prior_scale import PER_NAME
from residual.diagnosis.task import Task
from residual.evidence.design import Group
from residual.evidence.fit import Fit, Prior, System, fit, scaled_inverse
from residual.recording import Array

HOPELESS = 60.0  # nats that a prior may be behind and still be turned to


@dataclass(frozen=True, eq=False, slots=True)
class Bench:
    """A fit of the logs under several priors, ready to be asked about effects.

    Attributes:
        task: Data, chosen prior, candidates and rules.
        fitted: The fit to which an effect would come.
        systems: Its normal equations under each prior, the chosen one first.
        inverses: Posterior covariances of those. Each (m, m).
        scores: Evidence of the fit under each prior [nats].
        others: Per fold, covariance under the chosen prior without that fold.
        grams: Per fold, Gram of the fit on that fold. Each (dof, m, m).
        left: Squared error of all folds, each predicted from the others. (dof,).
    """

    task: Task
    fitted: Fit
    systems: tuple[System, ...]
    inverses: tuple[Array, ...]
    scores: tuple[float, ...]
    others: tuple[Array, ...]
    grams: tuple[Array, ...]
    left: Array

    @classmethod
    def of(cls, task: Task, fitted: Fit, priors: Sequence[Prior]) -> "Bench":
        """Solve once what all effects have in common.

        Args:
            task: Data, chosen prior, candidates and rules.
            fitted: The fit.
            priors: Other priors that the search may change to.
        """
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
            tuple(_covariance(s, weight) for s in systems),
            tuple(scores),
            tuple(others),
            tuple(grams),
            left_out(task, fitted, whole).sum(axis=0),
        )

    @property
    def weight(self) -> Array:
        """Information of a unit of squared error [1 / N^2 m^2]. Shape (dof,)."""
        return self.fitted.weight(self.task.design.rows)


@dataclass(frozen=True, eq=False, slots=True)
class Expected:
    """What an effect in one direction of its coefficients does, per unit squared.

    Attributes:
        fall: Squared error that it adds to each joint after a refit without it, under
            each prior. Shape (priors, dof).
        bent: Prior energy of that refit under each prior. Shape (priors,).
        occam: Occam factor of its coefficients under each prior [nats]. (priors,).
        held: Its own prior energy.
        out: Squared error that it adds to each fold predicted from the others, under
            the chosen prior. Shape (folds, dof).
        torque: Its own mean square torque, in shares of rms squared. Shape (dof,).
        count: Number of its coefficients.
        cost: Price of the choice [nats].
        counts: Part of the evidence that counts.
    """

    fall: Array
    bent: Array
    occam: Array
    held: float
    out: Array
    torque: Array
    count: int
    cost: float
    counts: float = 1.0


def expected(bench: Bench, group: Group, directions: Sequence[Array]) -> list[Expected]:
    """What a group does in each of some directions.

    Args:
        bench: The logs.
        group: The effect.
        directions: Coefficients of an effect of size one. Each (k,).
    """
    task, design = bench.task, bench.task.design
    own, mixed = _blocks(bench, group, None)
    falls, bends, occams, known = [], [], [], []
    for system, inverse in zip(bench.systems, bench.inverses, strict=True):
        moved = inverse @ np.tensordot(bench.weight, mixed, 1)
        falls.append(_added(system.gram, own, mixed, moved))
        bends.append(moved.T @ system.precision @ moved)
        known.append(np.tensordot(bench.weight, falls[-1], 1) + bends[-1])
        log_det = np.linalg.slogdet(known[-1] + group.precision)[1]
        occams.append(0.5 * max(log_det - group.log_det, 0.0))
    outs = [_left_out(bench, group, fold, mixed) for fold in range(design.folds)]
    return [
        Expected(
            fall=np.array([_along(f, u) for f in falls]),
            bent=np.array([u @ b @ u for b in bends]),
            occam=np.array(occams),
            held=float(u @ group.precision @ u),
            out=np.array([_along(o, u) for o in outs]),
            torque=_along(own, u) / design.rows / design.rms**2,
            count=len(group.ids),
            cost=task.candidates.cost(group),
            counts=_counts(task, group, known[0], u),
        )
        for u in directions
    ]


def _counts(task: Task, group: Group, information: Array, theta: Array) -> float:
    """Part of the evidence of a change that counts; the arm had none of it before."""
    habit = task.candidates.habit(group)
    if habit is None:
        return 1.0
    fresh = replace(habit, theta=np.zeros(len(theta)))
    return fresh.share(theta, information, group.precision)


def found(bench: Bench, one: Expected, size: float) -> bool:
    """Whether an effect of that size is found, if the noise does as it does on average.

    The estimate of the size is the one thing that chance moves; every rule below rises
    with it, so what holds at the average holds in half of the draws.
    """
    fitted, rules, square = bench.fitted, bench.task.rules, size**2
    rise = np.log1p(square * one.fall / np.maximum(fitted.sse, 1e-300))
    spared = 0.5 * square * one.bent
    lost = 0.5 * rise @ fitted.counted + spared  # by the fit without it
    paid = one.occam + 0.5 * square * one.held - 0.5 * one.count
    net = one.counts * (lost - paid) - one.cost
    named = bench.scores - paid - one.cost - PER_NAME
    wins = (net >= rules.threshold) & (named >= np.max(bench.scores - lost))
    if not wins.any():  # so of most sizes, and what follows takes the longest
        return False
    by_fit = _lowers(bench, square * one.fall) & _confirmed(bench, one, size)
    big = np.sqrt(square * one.torque).max() >= rules.size
    spares = (net >= rules.plausible) & (spared >= rules.bent * net) & big
    return bool(np.any(wins & (by_fit | spares)))


def _lowers(bench: Bench, fall: Array) -> Array:
    """Whether the error falls by enough under each prior. Shape (priors,)."""
    design, rules = bench.task.design, bench.task.rules
    relative = np.sqrt(fall / design.rows) / design.rms
    share = fall / np.maximum(bench.fitted.sse + fall, 1e-300)
    return rules.lower(relative, share).any(axis=1)


def _confirmed(bench: Bench, one: Expected, size: float) -> bool:
    """Whether logs left out are predicted better by enough, and enough of them."""
    fitted, design, rules = bench.fitted, bench.task.design, bench.task.rules
    acts = one.torque > 0
    # What its coefficients catch of the noise makes it predict worse.
    caught = one.count / max(acts.sum(), 1) * fitted.sse / fitted.counted
    fall = np.maximum(size**2 * one.out.sum(axis=0) - acts * caught, 0)
    power = np.maximum(design.tau_power.sum(axis=0), 1e-30)
    share = fall / np.maximum(bench.left + fall, 1e-300)
    enough = rules.lower(np.sqrt(fall / power), share)
    # A fold is better with it by a normal chance of this many standard deviations.
    sure = 0.5 * size * np.sqrt(np.maximum(one.out, 0) * bench.weight)
    folds = one.out > 1e-3 * np.maximum(one.out.max(axis=0), 1e-300)
    better = np.where(folds, ndtr(sure), 0).sum(axis=0) / np.maximum(folds.sum(0), 1)
    return bool(np.any(enough & (better >= MOST_FOLDS)))


def _near(task: Task, fitted: Fit, priors: Sequence[Prior]) -> tuple[list, list]:
    """The chosen prior and those that the search could turn to, with their evidence."""
    design, every = task.design, [task.prior, *priors]
    scores = [
        fit(design, p, fitted.members, fitted.counted, rounds=4).score for p in every
    ]
    near = [i for i, s in enumerate(scores) if i == 0 or s > max(scores) - HOPELESS]
    return [every[i] for i in near], [scores[i] for i in near]


def _covariance(system: System, weight: Array) -> Array:
    return scaled_inverse(
        system.precision + np.einsum("j,jmn->mn", weight, system.gram)
    )


def _blocks(bench: Bench, group: Group, fold: int | None) -> tuple[Array, Array]:
    """Gram of a group and with the fit, per joint. (dof, k, k), (dof, m, k)."""
    design, ids = bench.task.design, bench.systems[0].ids
    own = np.zeros((design.dof, len(group.ids), len(group.ids)))
    mixed = np.zeros((design.dof, len(ids), len(group.ids)))
    for j in range(design.dof):
        place, mine = design.present(j, group.ids)
        if len(place):
            theirs, have = design.present(j, ids)
            gram = design.total(j)[0] if fold is None else design.gram[j][fold]
            own[j, mine[:, None], mine] = gram[place[:, None], place]
            mixed[j, have[:, None], mine] = gram[theirs[:, None], place]
    return own, mixed


def _added(gram: Array, own: Array, mixed: Array, moved: Array) -> Array:
    """Squared error of a group less what the moved fit imitates. Shape (dof, k, k)."""
    across = moved.T @ mixed
    bent = moved.T @ (gram @ moved)
    return own - across - across.transpose(0, 2, 1) + bent


def _left_out(bench: Bench, group: Group, fold: int, every: Array) -> Array:
    """The same on one fold, the fit moved by the others. Shape (dof, k, k)."""
    own, mixed = _blocks(bench, group, fold)
    moved = bench.others[fold] @ np.tensordot(bench.weight, every - mixed, 1)
    return _added(bench.grams[fold], own, mixed, moved)


def _along(form: Array, u: Array) -> Array:
    """Quadratic form of each joint along a direction. Shape (dof,)."""
    return np.maximum(np.einsum("k,jkl,l->j", u, form, u), 0)
