"""The smallest effect that these logs would have shown, and what it resembles.

It rests on the motion and on the noise alone: what a fit with one effect leaves of
another, in nats.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import ndtr

from residual.diagnosis.gate import system_cross_validation_errors
from residual.diagnosis.search import SearchTask
from residual.effects.base import Effect, EffectTrait, PlacedEffect
from residual.evidence.design import CandidateColumns
from residual.evidence.fit import (
    Fit,
    FitEquations,
    NominalPrior,
    find_group_limits,
    fit_jointly,
    invert_scaled,
)
from residual.evidence.priors import stack_groups, weight_column_products
from residual.evidence.thresholds import THRESHOLDS
from residual.recording import Array
from residual.verdict.result import Detectable, Place


@dataclass(frozen=True, eq=False, slots=True)
class DetectionModel:
    """A fit of the logs under several priors, ready to be asked about effects."""

    task: SearchTask  # data, chosen prior, candidates and rules
    fitted: Fit  # the fit to which an effect would come
    # Its normal equations under each prior, the chosen one first.
    systems: tuple[FitEquations, ...]
    inverses: Array  # posterior covariances of those, (priors, m, m)
    scores: tuple[float, ...]  # evidence of the fit under each prior [nats]
    fold_covariances: (
        Array  # covariance under the chosen prior without each fold, (folds, m, m)
    )
    grams: Array  # gram of the fit on each fold, (folds, dof, m, m)
    left_out: (
        Array  # squared error of all folds, each predicted from the others, (dof,)
    )

    @classmethod
    def of(
        cls, task: SearchTask, fitted: Fit, priors: Sequence[NominalPrior]
    ) -> "DetectionModel":
        """Solve once what all effects have in common."""
        design = task.design
        every, scores = _near_priors(task, fitted, priors)
        systems = [FitEquations.of(design, p, fitted.members) for p in every]
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
            system_cross_validation_errors(task, fitted, whole).sum(axis=0),
        )

    @property
    def weight(self) -> Array:
        """Information of a unit of squared error [1 / N^2 m^2]. Shape (dof,)."""
        return self.fitted.weight(self.task.design.rows)


@dataclass(frozen=True, eq=False, slots=True)
class ExpectedEffect:
    """What an effect in one direction of its coefficients does, per unit squared."""

    # Squared error that it adds to each joint after a refit without it, under each
    # prior, (priors, dof).
    fall: Array
    bent: Array  # prior energy of that refit under each prior, (priors,)
    occam: Array  # occam factor of its coefficients under each prior [nats], (priors,)
    prior_energy: float  # its own prior energy
    # Squared error that it adds to each fold predicted from the others, under the
    # chosen prior, (folds, dof).
    fold_errors: Array
    torque: Array  # its own mean square torque, in shares of rms squared, (dof,)
    count: int  # number of its coefficients
    cost: float  # price of the choice [nats]


def predict_effect_evidence(
    detection: DetectionModel, group: CandidateColumns, directions: Sequence[Array]
) -> list[ExpectedEffect]:
    """What a group does in each of some directions."""
    task, design, weight = detection.task, detection.task.design, detection.weight
    group_gram, cross_gram = _blocks(detection, group)
    every, across = group_gram.sum(axis=0), cross_gram.sum(axis=0)  # over folds
    pull = np.tensordot(weight, across, 1)
    moved = detection.inverses @ pull
    # A prior bends the fit; what it leaves is the data's own affair.
    falls = _added_error(detection.systems[0].gram, every, across, moved[:, None])
    precisions = np.stack([system.precision for system in detection.systems])
    bends = moved.transpose(0, 2, 1) @ precisions @ moved
    information = np.tensordot(falls, weight, (1, 0)) + bends
    log_det = np.linalg.slogdet(information + group.precision)[1]
    without = detection.fold_covariances @ (
        pull - np.tensordot(cross_gram, weight, (1, 0))
    )
    outs = _added_error(detection.grams, group_gram, cross_gram, without[:, None])
    occam = 0.5 * np.maximum(log_det - group.log_det, 0.0)
    return [
        ExpectedEffect(
            fall=_quadratic_form(falls, u),
            bent=np.einsum("k,pkl,l->p", u, bends, u),
            occam=occam,
            prior_energy=float(u @ group.precision @ u),
            fold_errors=_quadratic_form(outs, u),
            torque=_quadratic_form(every, u) / design.rows / design.rms**2,
            count=len(group.ids),
            cost=task.candidates.cost(group),
        )
        for u in directions
    ]


def detects_sizes(
    detection: DetectionModel, effect: ExpectedEffect, sizes: Array
) -> Array:
    """Whether effects of some sizes are found, if the noise does as on average.

    The estimate of the size is the one thing that chance moves; every rule below rises
    with it, so what holds at the average holds in half of the draws.

    Args:
        sizes: Its sizes. Shape (s,).

    Returns:
        Shape (s,), bool.
    """
    fitted, rules = detection.fitted, detection.task.rules
    square = np.asarray(sizes)[:, None] ** 2
    fall = square[..., None] * effect.fall
    rise = np.log1p(fall / np.maximum(fitted.sse, 1e-300))
    spared = 0.5 * square * effect.bent
    lost = 0.5 * rise @ fitted.counted + spared  # by the fit without it
    paid = effect.occam + 0.5 * square * effect.prior_energy - 0.5 * effect.count
    net = lost - paid - effect.cost
    scores = np.array(detection.scores)
    named = scores - paid - effect.cost - THRESHOLDS.nats_per_name
    others = np.max(scores - lost, axis=1, keepdims=True)
    wins = (net >= rules.min_nats) & (named >= others)
    relative = np.sqrt(fall / detection.task.design.rows) / detection.task.design.rms
    share = fall / np.maximum(fitted.sse + fall, 1e-300)
    by_fit = rules.lower(relative, share).any(axis=2) & _confirmed(
        detection, effect, square
    )
    big = (
        np.sqrt(square * effect.torque).max(axis=1, keepdims=True)
        >= rules.min_plausible_torque
    )
    spares = (
        (net >= rules.min_plausible_nats)
        & (spared >= rules.min_prior_share * net)
        & big
    )
    return np.any(wins & (by_fit | spares), axis=1)


def _confirmed(bench: DetectionModel, effect: ExpectedEffect, square: Array) -> Array:
    """Whether logs left out are predicted better by enough, and enough of them.

    Args:
        square: Squares of its sizes. Shape (sizes, 1).

    Returns:
        Shape (sizes, 1).
    """
    fitted, design, rules = bench.fitted, bench.task.design, bench.task.rules
    acts = effect.torque > 0
    # What its coefficients catch of the noise makes it predict worse.
    caught = effect.count / max(acts.sum(), 1) * fitted.sse / fitted.counted
    fall = np.maximum(square * effect.fold_errors.sum(axis=0) - acts * caught, 0)
    power = np.maximum(design.tau_power.sum(axis=0), 1e-30)
    share = fall / np.maximum(bench.left_out + fall, 1e-300)
    enough = rules.lower(np.sqrt(fall / power), share)
    # A fold is better with it by a normal chance of this many standard deviations.
    sure = np.sqrt(square[..., None] * np.maximum(effect.fold_errors, 0) * bench.weight)
    folds = effect.fold_errors > 1e-3 * np.maximum(
        effect.fold_errors.max(axis=0), 1e-300
    )
    better = np.where(folds, ndtr(0.5 * sure), 0).sum(axis=1)
    better = better / np.maximum(folds.sum(axis=0), 1)
    return np.any(
        enough & (better >= THRESHOLDS.min_improved_folds), axis=1, keepdims=True
    )


def _near_priors(
    task: SearchTask, fitted: Fit, priors: Sequence[NominalPrior]
) -> tuple[list, list]:
    """The chosen prior and its competitors, with the evidence of each."""
    design, every = task.design, [task.prior, *priors]
    scores = [
        fit_jointly(design, p, fitted.members, fitted.counted, rounds=4).score
        for p in every
    ]
    near = [
        i
        for i, s in enumerate(scores)
        if i == 0 or s > max(scores) - THRESHOLDS.hopeless_nats
    ]
    return [every[i] for i in near], [scores[i] for i in near]


def _covariance(system: FitEquations, weight: Array) -> Array:
    return invert_scaled(system.precision + np.einsum("j,jmn->mn", weight, system.gram))


def _blocks(bench: DetectionModel, group: CandidateColumns) -> tuple[Array, Array]:
    """Gram of a group and with the fit, per fold and joint.

    Returns:
        Shapes (folds, dof, k, k), (folds, dof, m, k).
    """
    design, ids = bench.task.design, bench.systems[0].ids
    shape, k = (design.folds, design.dof), len(group.ids)
    group_gram, cross_gram = np.zeros((*shape, k, k)), np.zeros((*shape, len(ids), k))
    for j in range(design.dof):
        place, columns = design.present(j, group.ids)
        if len(place):
            fit_places, have = design.present(j, ids)
            gram = design.gram[j]
            group_gram[:, j, columns[:, None], columns] = gram[:, place[:, None], place]
            cross_gram[:, j, have[:, None], columns] = gram[
                :, fit_places[:, None], place
            ]
    return group_gram, cross_gram


def _added_error(
    gram: Array, group_gram: Array, cross_gram: Array, shift: Array
) -> Array:
    """Squared error of a group less what the moved fit imitates. Shape (..., k, k).

    Args:
        gram: Of the fit. Shape (..., m, m).
        group_gram: Of the group. Shape (..., k, k).
        cross_gram: Of the fit with the group. Shape (..., m, k).
        shift: What the fit moves by. Shape (..., m, k).
    """
    turned = np.swapaxes(shift, -1, -2)
    across = turned @ cross_gram
    return group_gram - across - np.swapaxes(across, -1, -2) + turned @ (gram @ shift)


def _quadratic_form(form: Array, u: Array) -> Array:
    """Quadratic forms along a direction. Shape (...) of (..., k, k)."""
    return np.maximum(np.einsum("k,...kl,l->...", u, form, u), 0)


FLAT = 1e-9  # of the largest information of a group: a direction that does nothing


def find_lookalikes(
    task: SearchTask, fitted: Fit, effects: Sequence[tuple[CandidateColumns, Array]]
) -> list[tuple[Place, ...]]:
    """Candidates that would explain each effect within 6 nats.

    The nominal model bends with them. Of several shapes of a candidate the best counts;
    effects on all joints at once are left out.

    Args:
        effects: Each with its coefficients. Shapes (k,).
    """
    design = task.design
    weight = fitted.weight(design.rows)
    system = FitEquations.of(design, task.prior, fitted.members)
    shared = weight_column_products(design, system, weight)
    half = solve_triangular(system.solve(weight)[1], shared, lower=True)
    others = [g for g in task.candidates.groups if not g.parts]
    bases = [
        (
            [others[i] for i in stack.members],
            stack.ids,
            _root(stack.beyond(weight, half)),
        )
        for stack in stack_groups(design, others)
    ]
    out = []
    for group, theta in effects:
        pull = _products(task, group, theta, weight) - half.T @ (
            half[:, group.ids] @ theta
        )
        every = theta @ pull[group.ids]
        lost: dict[tuple, float] = {}
        for members, ids, root in bases:
            caught = np.square(np.einsum("gij,gi->gj", root, pull[ids])).sum(axis=1)
            for other, part in zip(members, caught, strict=True):
                key = (other.effect.name, other.joints)
                lost[key] = min(lost.get(key, np.inf), 0.5 * float(every - part))
        place = (group.effect.name, group.joints)
        # To a hundredth of a nat: what is lost to twins is rounding, and would order
        # them otherwise on another processor.
        near = sorted(
            (round(x, 2), key)
            for key, x in lost.items()
            if x < THRESHOLDS.class_nats and key != place
        )
        out.append(tuple(Place(n, tuple(j + 1 for j in js)) for _, (n, js) in near))
    return out


def _products(
    task: SearchTask, group: CandidateColumns, theta: Array, weight: Array
) -> Array:
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


WIDEST, STEPS = 300.0, 24  # times the size that is worth a nat: where to look
FINER = 128  # steps from one of those to the next
CLIPS = (0.95, 0.9, 0.8, 0.7, 0.6, 0.5)  # of the largest torque: plateaus to try


def find_detectable_sizes(
    task: SearchTask, fitted: Fit, priors: Sequence[NominalPrior] = ()
) -> list[Detectable]:
    """Size that would be found in half of the draws of the noise, per effect and joint.

    Found means all that a name must do: win the threshold with its price paid, stand
    against a wider prior without a name, and lower the error, also that of logs left
    out, by the rules' tolerance and share; or spare the parameters beyond belief.

    Returns:
        One entry per effect and joints. Of several
        parameters of one unit the value is the length (cos and sin), of a searched
        shape the usual one counts.
    """
    bench, robot = DetectionModel.of(task, fitted, priors), task.design.states[0].robot
    sizes: list[_SmallestEffect] = []
    keys: dict[tuple, list[CandidateColumns]] = {}
    for g in task.candidates.groups:
        if not g.parts:
            keys.setdefault((g.effect.name, g.joints), []).append(g)
    for groups in keys.values():
        first = groups[0]
        if first.key in {g.key for g in fitted.members}:
            continue
        if len({robot.prismatic[j] for j in first.joints}) > 1 and first.parts:
            continue  # of several units
        smallest = _smallest_effect(bench, groups)
        if smallest is not None:
            sizes.append(smallest)
    alike = find_lookalikes(
        task,
        fitted,
        [(x.group, THRESHOLDS.confusable_size_factor * x.theta) for x in sizes],
    )
    return [
        Detectable(
            name=x.group.effect.name,
            joints=tuple(j + 1 for j in x.group.joints),
            value=_possible_size(bench, x),
            unit=next(iter(x.group.effect.units(x.group.joints, robot).values())),
            confusable=near,
        )
        for x, near in zip(sizes, alike, strict=True)
    ]


@dataclass(frozen=True, eq=False, slots=True)
class _SmallestEffect:
    """The smallest effect that is found: as it is told, and as coefficients."""

    value: float
    group: CandidateColumns
    theta: Array


def _possible_size(bench: DetectionModel, least: _SmallestEffect) -> float | None:
    """The size; None where no arm has an effect that large."""
    design, group = bench.task.design, least.group
    limits = find_group_limits(design, bench.fitted, group)
    shape, signs = group.shape, (least.theta, -least.theta)
    if _of_its_own_shape(group.effect, group):
        shape = (least.value, *shape[1:])
    if any(group.effect.possible(theta, shape, limits) for theta in signs):
        return float(least.value)
    return None


def _smallest_effect(
    bench: DetectionModel, groups: Sequence[CandidateColumns]
) -> _SmallestEffect | None:
    effect, middle = groups[0].effect, groups[len(groups) // 2]
    if _by_shape_alone(effect, middle):
        # The highest plateau of those tried at which a clip to its level is found.
        last = groups[-1]
        levels = [
            PlacedEffect(effect, last.joints, (c * last.shape[0],)) for c in CLIPS
        ]
        for clip in bench.task.design.add(levels):
            (one,) = predict_effect_evidence(bench, clip, [np.ones(1)])
            if one.torque.any() and detects_sizes(bench, one, np.ones(1)).all():
                return _SmallestEffect(clip.shape[0], clip, np.ones(1))
        return None
    if _of_its_own_shape(effect, middle):
        sizes = np.array([_smallest(bench, g) for g in groups])
        shapes = np.abs([g.shape[0] for g in groups])
        i = int(np.argmin(np.abs(np.log(sizes / shapes))))
        return _with_direction(sizes[i], sizes[i], bench, groups[i])
    size, middle = _median_shape(bench, groups)
    if len(middle.ids) > 1 or not np.isfinite(size):
        return _with_direction(size, size, bench, middle)
    robot = bench.task.design.states[0].robot
    told = effect.values(np.array([size]), middle.shape, robot)
    return _with_direction(abs(told[0]), size, bench, middle)


def _median_shape(
    bench: DetectionModel, groups: Sequence[CandidateColumns]
) -> tuple[float, CandidateColumns]:
    """Smallest coefficient that is found, and the shape that it is of.

    The usual shape, or the middle of those that an effect may hide in: friction that
    fades below the speed at which rows count is found by its tail alone.
    """
    effect, joints = groups[0].effect, groups[0].joints
    shapes = [PlacedEffect(effect, joints, shape) for shape in effect.least_seen]
    made = bench.task.design.add(shapes) or [groups[len(groups) // 2]]
    sizes = [_smallest(bench, group) for group in made]
    return float(np.median(sizes)), made[int(np.argsort(sizes)[len(sizes) // 2])]


def _with_direction(
    value: float, size: float, bench: DetectionModel, group: CandidateColumns
) -> _SmallestEffect | None:
    if not np.isfinite(value):
        return None
    return _SmallestEffect(
        float(value), group, size * unit_effect_coefficients(bench, group)[0]
    )


def _smallest(bench: DetectionModel, group: CandidateColumns) -> float:
    """Smallest detectable coefficient; the median over directions."""
    sizes = []
    for one in predict_effect_evidence(
        bench, group, unit_effect_coefficients(bench, group)
    ):
        information = bench.weight @ one.fall[0] + one.bent[0]
        if information <= 0:
            sizes.append(np.inf)
            continue
        sizes.append(_first_detected(bench, one, np.sqrt(2 / information)))
    return float(np.median(sizes))


def _first_detected(
    bench: DetectionModel, effect: ExpectedEffect, unit: float
) -> float:
    """First size that is found, climbing from what is worth a nat.

    Far above it an effect may be lost again, since its own prior does not believe it.
    """
    ladder = unit * np.geomspace(1, WIDEST, STEPS)
    detected = detects_sizes(bench, effect, ladder)
    if detected[0] or not detected.any():
        return float(ladder[0]) if detected[0] else np.inf
    step = int(np.argmax(detected))
    between = np.geomspace(ladder[step - 1], ladder[step], FINER + 1)[1:]
    return float(between[int(np.argmax(detects_sizes(bench, effect, between)))])


def unit_effect_coefficients(
    detection: DetectionModel, group: CandidateColumns
) -> list[Array]:
    """Coefficients of an effect of size one, in the ways that it usually comes.

    Effects say so themselves where their coefficients differ in kind; those that are
    one vector come in any direction; of others the first coefficient is the size.
    """
    effect, count = group.effect, len(group.ids)
    if effect.unit_directions is not None:
        return effect.unit_directions(detection.task.design.states, group.joints)
    if not _one_vector(effect, group):
        return [np.eye(count)[0]]
    every = [np.array(u, dtype=float) for u in product((-1, 0, 1), repeat=count)]
    half = every[len(every) // 2 + 1 :]  # the others point the other way
    return [u / np.linalg.norm(u) for u in half]


def _one_vector(effect: Effect, group: CandidateColumns) -> bool:
    count = len(group.ids)
    units = list(effect.parameters.values())[:count]
    alike = len(units) == count and len(set(units)) == 1
    return count > 1 and (EffectTrait.PERIODIC in effect.traits or alike)


def _of_its_own_shape(effect: Effect, group: CandidateColumns) -> bool:
    """Whether the shape is the size (the half gap of a backlash)."""
    if effect.refine is None or len(group.ids) > 1 or len(effect.parameters) > 1:
        return False
    return not _by_shape_alone(effect, group)


def _by_shape_alone(effect: Effect, group: CandidateColumns) -> bool:
    """Whether the shape alone is the size (the level of a plateau)."""
    if effect.refine is None or len(effect.parameters) > 1:
        return False
    values = [effect.values(c * np.ones(1), group.shape, None)[0] for c in (1.0, 2.0)]
    return bool(values[0] == values[1])
