"""The smallest detectable effects in some logs, and what they resemble.

The evidence of an effect theta is a function of W = theta' K theta, with K its
information beyond the fit: the size at which the evidence suffices for a name has a
closed form, except for the mixture over sizes of the prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from residual.diagnosis.score import count_merged_blocks, mixture_evidence
from residual.diagnosis.search import Search
from residual.effects.base import Effect, EffectTrait, PlacedEffect
from residual.evidence.design import CandidateColumns, Design
from residual.evidence.fit import Fit, FitEquations, find_group_limits
from residual.evidence.priors import project_columns, stack_groups
from residual.evidence.thresholds import THRESHOLDS
from residual.recording import Array
from residual.verdict.result import Detectable, Place


@dataclass(frozen=True, eq=False, slots=True)
class DetectionModel:
    """A fit of the logs, prepared for detectable sizes."""

    search: Search
    fitted: Fit  # the fit that an effect would be added to
    weight: Array  # information of a unit of squared error, (dof,)
    half: Array  # products of its columns with all, by its lower factor, (m, size)

    @classmethod
    def of(cls, search: Search, fitted: Fit) -> "DetectionModel":
        """Solve the part common to all effects."""
        design = search.score.design
        weight = fitted.weight
        system = FitEquations.of(design, search.score.prior, fitted.members)
        return cls(search, fitted, weight, project_columns(design, system, weight))

    def information(self, group: CandidateColumns) -> Array:
        """Information of the logs on a group beyond the fit. Shape (k, k)."""
        (stack,) = stack_groups(self.search.score.design, [group])
        half = self.half
        if half.shape[1] <= group.ids.max():  # columns added since
            half = DetectionModel.of(self.search, self.fitted).half
        return stack.beyond(self.weight, half)[0]

    def smallest(self, group: CandidateColumns, direction: Array) -> float:
        """Least size along a direction that is named in half of the cases."""
        design, known = self.search.score.design, self.information(group)
        along = float(direction @ known @ direction)
        torque = 0.0
        for j in range(design.dof):
            place, have = design.present(j, group.ids)
            if len(place):
                gram, _ = design.sums(j, place)
                power = direction[have] @ gram @ direction[have] / design.rows[j]
                torque = max(torque, float(power) / design.rms[j] ** 2)
        if along <= 0 or torque <= 0:
            return np.inf
        # The least evidence counts: that of the longest blocks, of fewest degrees.
        degrees = THRESHOLDS.prior_blocks + min(count_merged_blocks(design.folds))
        sizes = np.geomspace(1, WIDEST, STEPS) / np.sqrt(along)
        pull, prior = known @ direction, group.precision
        nats = mixture_evidence(known, pull, prior, degrees, sizes)
        enough = nats >= max(THRESHOLDS.named_nats, self.search.least + self.search.cost(group))
        if not enough.any():
            return np.inf
        i = int(np.argmax(enough))
        low, high = nats[max(i - 1, 0)], nats[i]
        part = (THRESHOLDS.named_nats - low) / max(high - low, 1e-9) if i else 0.0
        ratio = WIDEST ** (1 / (STEPS - 1))
        size = sizes[max(i - 1, 0)] * ratio ** float(np.clip(part, 0.0, 1.0))
        # It must be large enough for a name by its torque, or by the error without it.
        left = float(np.max(design.rms**2 / np.maximum(self.fitted.variance, 1e-300)))
        share = np.sqrt(torque * max(1.0, left * THRESHOLDS.min_share))
        return max(float(size), THRESHOLDS.min_share / share)


FLAT = 1e-9  # of the largest information of a group: a direction without effect


def find_lookalikes(
    bench: DetectionModel, effects: Sequence[tuple[CandidateColumns, Array]]
) -> list[tuple[Place, ...]]:
    """Find the candidates that would explain each effect within 6 nats.

    The nominal model is refitted. Of several shapes of a candidate the best counts;
    effects on all joints at once are left out.

    Args:
        effects: Each with its coefficients. Shapes (k,).
    """
    search, fitted, weight = bench.search, bench.fitted, bench.weight
    design = search.score.design
    half = DetectionModel.of(search, fitted).half
    others = [g for g in search.candidates.groups if not g.parts]
    bases = [
        ([others[i] for i in stack.members], stack.ids, _root(stack.beyond(weight, half)))
        for stack in stack_groups(design, others)
    ]
    out = []
    for group, theta in effects:
        pull = _products(design, group, theta, weight) - half.T @ (half[:, group.ids] @ theta)
        every = theta @ pull[group.ids]
        lost: dict[tuple, float] = {}
        for members, ids, root in bases:
            caught = np.square(np.einsum("gij,gi->gj", root, pull[ids])).sum(axis=1)
            for other, part in zip(members, caught, strict=True):
                key = (other.effect.name, other.joints)
                lost[key] = min(lost.get(key, np.inf), 0.5 * float(every - part))
        place = (group.effect.name, group.joints)
        # To a hundredth of a nat: the loss of twins is rounding, which would order them
        # differently on another processor.
        near = sorted(
            (round(x, 2), key)
            for key, x in lost.items()
            if x < THRESHOLDS.class_nats and key != place
        )
        out.append(tuple(Place(n, tuple(j + 1 for j in js)) for _, (n, js) in near))
    return out


def _products(design: Design, group: CandidateColumns, theta: Array, weight: Array) -> Array:
    """Weighted products of an effect's torque with all columns. Shape (size,)."""
    out = np.zeros(design.size)
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


WIDEST, STEPS = 300.0, 24  # times the size of one nat: search grid
CLIPS = (0.95, 0.9, 0.8, 0.7, 0.6, 0.5)  # of the largest torque: plateaus to try


def find_detectable_sizes(search: Search, fitted: Fit) -> list[Detectable]:
    """Return the size that is named in half of the cases, by effect and joint.

    Returns:
        One entry per effect and joints. Of several parameters of one unit the value is
        the length (cos and sin); of a searched shape the typical one counts.
    """
    bench = DetectionModel.of(search, fitted)
    design = search.score.design
    robot = design.states[0].robot
    sizes: list[_SmallestEffect] = []
    keys: dict[tuple, list[CandidateColumns]] = {}
    for g in search.candidates.groups:
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
        bench, [(x.group, THRESHOLDS.confusable_size_factor * x.theta) for x in sizes]
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
    """The smallest detectable effect: as reported, and as coefficients."""

    value: float
    group: CandidateColumns
    theta: Array


def _possible_size(bench: DetectionModel, least: _SmallestEffect) -> float | None:
    """The size; None if no arm has an effect that large."""
    design, group = bench.search.score.design, least.group
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
        # The highest of the plateaus at which a clip is detected.
        last = groups[-1]
        levels = [PlacedEffect(effect, last.joints, (c * last.shape[0],)) for c in CLIPS]
        for clip in bench.search.score.design.add(levels):
            if bench.smallest(clip, np.ones(1)) <= 1.0:
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
    robot = bench.search.score.design.states[0].robot
    values = effect.values(np.array([size]), middle.shape, robot)
    return _with_direction(abs(values[0]), size, bench, middle)


def _median_shape(
    bench: DetectionModel, groups: Sequence[CandidateColumns]
) -> tuple[float, CandidateColumns]:
    """Smallest detectable coefficient, and its shape.

    The typical shape, or the median of the least visible ones: friction that fades below
    the speed at which rows count is detected only by its tail.
    """
    effect, joints = groups[0].effect, groups[0].joints
    shapes = [PlacedEffect(effect, joints, shape) for shape in effect.least_seen]
    added = bench.search.score.design.add(shapes) or [groups[len(groups) // 2]]
    sizes = [_smallest(bench, group) for group in added]
    return float(np.median(sizes)), added[int(np.argsort(sizes)[len(sizes) // 2])]


def _with_direction(
    value: float, size: float, bench: DetectionModel, group: CandidateColumns
) -> _SmallestEffect | None:
    if not np.isfinite(value):
        return None
    return _SmallestEffect(float(value), group, size * unit_effect_coefficients(bench, group)[0])


def _smallest(bench: DetectionModel, group: CandidateColumns) -> float:
    """Smallest detectable coefficient; the median over directions."""
    directions = unit_effect_coefficients(bench, group)
    return float(np.median([bench.smallest(group, u) for u in directions]))


def unit_effect_coefficients(detection: DetectionModel, group: CandidateColumns) -> list[Array]:
    """Coefficients of an effect of size one, in its typical directions.

    Effects whose coefficients differ in kind define them; those that form one vector have
    any direction; for others the first coefficient is the size.
    """
    effect, count = group.effect, len(group.ids)
    if effect.unit_directions is not None:
        return effect.unit_directions(detection.search.score.design.states, group.joints)
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
    """Whether the shape is also the size (the half gap of a backlash)."""
    if effect.refine is None or len(group.ids) > 1 or len(effect.parameters) > 1:
        return False
    return not _by_shape_alone(effect, group)


def _by_shape_alone(effect: Effect, group: CandidateColumns) -> bool:
    """Whether the shape alone is the size (the level of a plateau)."""
    if effect.refine is None or len(effect.parameters) > 1:
        return False
    values = [effect.values(c * np.ones(1), group.shape, None)[0] for c in (1.0, 2.0)]
    return bool(values[0] == values[1])
