"""The smallest effect that these logs would have shown, and what it resembles.

It rests on the motion and on the noise alone: what a fit with one effect leaves of
another, in nats.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular

from residual.diagnosis.expected_gain import Bench, Expected, expected, found
from residual.diagnosis.result import Detectable, Place
from residual.diagnosis.search import Candidates, Task, search
from residual.effects.base import Effect, Placed, Trait
from residual.evidence.design import Group
from residual.evidence.fit import Fit, Prior, System, fit, limits_of
from residual.evidence.priors import WIDTHS, Space, overlap, stacks
from residual.evidence.rules import RULES, Rules
from residual.recording import Array

FLAT = 1e-9  # of the largest information of a group: a direction that does nothing


def lookalikes(
    task: Task, fitted: Fit, effects: Sequence[tuple[Group, Array]]
) -> list[tuple[Place, ...]]:
    """Candidates that would explain each effect within 6 nats.

    The nominal model bends with them. Of several shapes of a candidate the best counts;
    effects on all joints at once are left out.

    Args:
        effects: Each with its coefficients. Shapes (k,).
    """
    design = task.design
    weight = fitted.weight(design.rows)
    system = System.of(design, task.prior, fitted.members)
    shared = overlap(design, system, weight)
    half = solve_triangular(system.solve(weight)[1], shared, lower=True)
    others = [g for g in task.candidates.groups if not g.parts]
    bases = [
        (
            [others[i] for i in stack.members],
            stack.ids,
            _root(stack.beyond(weight, half)),
        )
        for stack in stacks(design, others)
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
        # To a hundredth of a nat: what is lost to twins is rounding, and would order
        # them otherwise on another processor.
        near = sorted(
            (round(x, 2), key)
            for key, x in lost.items()
            if x < RULES.class_nats and key != own
        )
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


WIDEST, STEPS = 300.0, 24  # times the size that is worth a nat: where to look
FINER = 128  # steps from one of those to the next
CLIPS = (0.95, 0.9, 0.8, 0.7, 0.6, 0.5)  # of the largest torque: plateaus to try


def minimum_detectable(
    task: Task, fitted: Fit, priors: Sequence[Prior] = ()
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
    bench, robot = Bench.of(task, fitted, priors), task.design.states[0].robot
    sizes: list[_Least] = []
    for groups in _per_key(task):
        first = groups[0]
        if first.key in {g.key for g in fitted.members}:
            continue
        if len({robot.prismatic[j] for j in first.joints}) > 1 and first.parts:
            continue  # of several units
        least = _least(bench, groups)
        if least is not None:
            sizes.append(least)
    alike = lookalikes(
        task, fitted, [(x.group, RULES.clear_size * x.theta) for x in sizes]
    )
    return [
        Detectable(
            name=x.group.effect.name,
            joints=tuple(j + 1 for j in x.group.joints),
            value=_there_is(bench, x),
            unit=next(iter(x.group.effect.units(x.group.joints, robot).values())),
            confusable=near,
        )
        for x, near in zip(sizes, alike, strict=True)
    ]


def _per_key(task: Task) -> list[list[Group]]:
    keys: dict[tuple, list[Group]] = {}
    for g in task.candidates.groups:
        if not g.parts:
            keys.setdefault((g.effect.name, g.joints), []).append(g)
    return list(keys.values())


@dataclass(frozen=True, eq=False, slots=True)
class _Least:
    """The smallest effect that is found: as it is told, and as coefficients."""

    value: float
    group: Group
    theta: Array


def _there_is(bench: Bench, least: _Least) -> float | None:
    """The size; None where no arm has an effect as large."""
    design, group = bench.task.design, least.group
    limits = limits_of(design, bench.fitted, group)
    shape, either = group.shape, (least.theta, -least.theta)
    if _of_its_own_shape(group.effect, group):
        shape = (least.value, *shape[1:])
    if any(group.effect.possible(theta, shape, limits) for theta in either):
        return float(least.value)
    return None


def _least(bench: Bench, groups: Sequence[Group]) -> _Least | None:
    """The size as its first parameter tells it; None where no size is found."""
    effect, middle = groups[0].effect, groups[len(groups) // 2]
    if _by_shape_alone(effect, middle):
        return _plateau(bench, groups[-1])
    if _of_its_own_shape(effect, middle):
        sizes = np.array([_smallest(bench, g) for g in groups])
        shapes = np.abs([g.shape[0] for g in groups])
        i = int(np.argmin(np.abs(np.log(sizes / shapes))))
        return _known(sizes[i], sizes[i], bench, groups[i])
    size, middle = _middle(bench, groups)
    if len(middle.ids) > 1 or not np.isfinite(size):
        return _known(size, size, bench, middle)
    robot = bench.task.design.states[0].robot
    told = effect.values(np.array([size]), middle.shape, robot)
    return _known(abs(told[0]), size, bench, middle)


def _middle(bench: Bench, groups: Sequence[Group]) -> tuple[float, Group]:
    """Smallest coefficient that is found, and the shape that it is of.

    The usual shape, or the middle of those that an effect may hide in: friction that
    fades below the speed at which rows count is found by its tail alone.
    """
    effect, joints = groups[0].effect, groups[0].joints
    shapes = [Placed(effect, joints, shape) for shape in effect.least_seen]
    made = bench.task.design.add(shapes) or [groups[len(groups) // 2]]
    sizes = [_smallest(bench, group) for group in made]
    return float(np.median(sizes)), made[int(np.argsort(sizes)[len(sizes) // 2])]


def _known(value: float, size: float, bench: Bench, group: Group) -> _Least | None:
    if not np.isfinite(value):
        return None
    return _Least(float(value), group, size * directions(bench, group)[0])


def _smallest(bench: Bench, group: Group) -> float:
    """Smallest coefficient that is found; of several directions the median."""
    sizes = []
    for one in expected(bench, group, directions(bench, group)):
        known = bench.weight @ one.fall[0] + one.bent[0]
        if known <= 0:
            sizes.append(np.inf)
            continue
        sizes.append(_first(bench, one, np.sqrt(2 / known)))
    return float(np.median(sizes))


def _first(bench: Bench, one: Expected, unit: float) -> float:
    """First size that is found, climbing from what is worth a nat.

    Far above it an effect may be lost again, since its own prior does not believe it.
    """
    ladder = unit * np.geomspace(1, WIDEST, STEPS)
    seen = found(bench, one, ladder)
    if seen[0] or not seen.any():
        return float(ladder[0]) if seen[0] else np.inf
    step = int(np.argmax(seen))
    between = np.geomspace(ladder[step - 1], ladder[step], FINER + 1)[1:]
    return float(between[int(np.argmax(found(bench, one, between)))])


def directions(bench: Bench, group: Group) -> list[Array]:
    """Coefficients of an effect of size one, in the ways that it usually comes.

    Effects say so themselves where their coefficients differ in kind; those that are
    one vector come in any direction; of others the first coefficient is the size.
    """
    effect, count = group.effect, len(group.ids)
    if effect.usual is not None:
        return effect.usual(bench.task.design.states, group.joints)
    if not _one_vector(effect, group):
        return [np.eye(count)[0]]
    every = [np.array(u, dtype=float) for u in product((-1, 0, 1), repeat=count)]
    half = every[len(every) // 2 + 1 :]  # the others point the other way
    return [u / np.linalg.norm(u) for u in half]


def _one_vector(effect: Effect, group: Group) -> bool:
    count = len(group.ids)
    units = list(effect.parameters.values())[:count]
    alike = len(units) == count and len(set(units)) == 1
    return count > 1 and (Trait.PERIODIC in effect.traits or alike)


def _of_its_own_shape(effect: Effect, group: Group) -> bool:
    """Whether the size is the searched shape as well (the half gap of a backlash)."""
    if effect.refine is None or len(group.ids) > 1 or len(effect.parameters) > 1:
        return False
    return not _by_shape_alone(effect, group)


def _by_shape_alone(effect: Effect, group: Group) -> bool:
    """Whether the size does not depend on the coefficient (the level of a plateau)."""
    if effect.refine is None or len(effect.parameters) > 1:
        return False
    values = [effect.values(c * np.ones(1), group.shape, None)[0] for c in (1.0, 2.0)]
    return bool(values[0] == values[1])


def _plateau(bench: Bench, group: Group) -> _Least | None:
    """Highest plateau of those tried at which a clip to just that level is found."""
    levels = [(group.effect, group.joints, (c * group.shape[0],)) for c in CLIPS]
    for made in bench.task.design.add(levels):
        (one,) = expected(bench, made, [np.ones(1)])
        if one.torque.any() and found(bench, one, np.ones(1)).all():
            return _Least(made.shape[0], made, np.ones(1))
    return None


# Choose the set of effects, the scale of the rigid prior and that of given values.
#
# They are chosen together, after the search: a scale chosen before it widens until the
# parameters swallow the effect. So with the values that a model is given, kind by kind:
# of twenty that are right the twenty-first stands out, of twenty rough ones none does.


@dataclass(frozen=True, eq=False, slots=True)
class Selection:
    """The search's result."""

    task: Task  # data under the chosen prior
    fit: Fit  # its best fit
    # The widest prior that the logs do not contradict, for standard deviations.
    wide: Prior


@dataclass(frozen=True, eq=False, slots=True)
class _Runs:
    """Searches so far by the prior's scale and widths, and what each may name."""

    space: Space
    candidates: Candidates
    rules: Rules
    done: dict[tuple, Selection] = field(default_factory=dict)
    allowed: dict[frozenset[str], Candidates] = field(default_factory=dict)

    def search(self, prior: Prior) -> None:
        """Search under a prior, unless that was done."""
        if (key := _key(prior)) not in self.done:
            barred = frozenset(self.space.barred(prior))
            if barred not in self.allowed:
                self.allowed[barred] = self.candidates.without(tuple(barred))
            task = Task(self.space.design, prior, self.allowed[barred], self.rules)
            self.done[key] = Selection(task, search(task), prior)

    @property
    def counted(self) -> Array:
        """Rows of each joint, counted alike for all runs. Shape (dof,)."""
        return np.max([r.fit.counted for r in self.done.values()], axis=0)

    @property
    def best(self) -> Selection:
        """The run with the most evidence."""
        counted = self.counted
        return max(self.done.values(), key=lambda r: _worth(r, counted))

    def score(self, prior: Prior, run: Selection) -> float:
        """Evidence of a run's set under another prior [nats]."""
        members = run.fit.members
        return fit(self.space.design, prior, members, self.counted, rounds=4).score


def _key(prior: Prior) -> tuple:
    return prior.scale, tuple(sorted(prior.widths.items()))


def select(
    space: Space,
    candidates: Candidates,
    rules: Rules,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Selection:
    """Search under the priors and keep the pair with the most evidence.

    Every scale of the rigid part is tried with the values as they were said to be; at
    each that is a hill, every width for all of them; then each kind of value may go
    its own way; then that scale's neighbours.

    Args:
        candidates: All that may be named under some prior.
    """
    runs, turns = _Runs(space, candidates, rules), (_as_said, _even, _by_kind, _beside)
    for turn, wanted in enumerate(turns):
        for prior in wanted(runs):
            runs.search(prior)
            progress((turn + len(runs.done) / (len(runs.done) + 2)) / len(turns))
    best = runs.best
    return replace(best, fit=best.task.settle(best.fit), wide=_widest(runs, best))


def _as_said(runs: _Runs) -> Iterable[Prior]:
    return [runs.space.at(scale, runs.space.even[0]) for scale in runs.space.scales]


def _even(runs: _Runs) -> Iterable[Prior]:
    """Every width at the best scale, and at others that are best beside their own.

    A sharp prior with names and a wide one without are two hills of evidence.
    """
    scales, counted = runs.space.scales, runs.counted
    worth = [_worth(run, counted) for run in runs.done.values()]  # one a scale, so far
    walls = [-np.inf, *worth, -np.inf]
    tops = [
        scale
        for i, scale in enumerate(scales)
        if worth[i] >= max(walls[i], walls[i + 2])
        and worth[i] > max(worth) - RULES.hill
    ]
    return [runs.space.at(s, widths) for s in tops for widths in runs.space.even]


def _by_kind(runs: _Runs) -> Iterable[Prior]:
    """Widths of single kinds, by the evidence with the best run's names held."""
    for _ in range(RULES.width_rounds):
        best = runs.best
        if not runs.space.free or len(best.wide.widths) < 2:
            return
        turned = _turned(runs, best)
        if _key(turned) in runs.done:
            return
        yield turned


def _turned(runs: _Runs, best: Selection) -> Prior:
    """The prior with each kind's width at its best, one after the other."""
    prior = best.wide
    for kind in best.wide.widths:
        trials = [
            runs.space.at(prior.scale, {**prior.widths, kind: width})
            for width in WIDTHS
        ]
        prior = max([prior, *trials], key=lambda p: runs.score(p, best))
    return prior


def _beside(runs: _Runs) -> Iterable[Prior]:
    best, scales = runs.best.wide, runs.space.scales
    at = scales.index(best.scale)
    return [runs.space.at(s, best.widths) for s in scales[max(at - 1, 0) : at + 2]]


def _widest(runs: _Runs, run: Selection) -> Prior:
    """The widest prior within 6 nats, and none under 10 % where the scale is open.

    How wrong a URDF is can be estimated only as far as the wrong values can be seen;
    what trades off against a load cannot. Given values are held as they were when the
    effects were named: one that may be off at will leaves nothing to be named.
    """
    prior, scales = run.task.prior, runs.space.scales
    if len(scales) == 1:
        return prior
    alike = [runs.space.at(s, prior.widths) for s in scales]
    scores = [runs.score(p, run) for p in alike]
    near = [
        p
        for p, score in zip(alike, scores, strict=True)
        if score > max(scores) - RULES.alike_scales or p.scale == RULES.least_wide
    ]
    return max(near, key=lambda p: p.scale)


def neighbours(space: Space, prior: Prior) -> tuple[Prior, ...]:
    """Priors that a search might have turned to, beside the one that it chose."""
    wanted = [(s, widths) for widths in space.even for s in space.scales]
    wanted += [(s, prior.widths) for s in space.scales]
    if space.free and len(prior.widths) > 1:
        wanted += [
            (prior.scale, {**prior.widths, kind: width})
            for kind in prior.widths
            for width in WIDTHS
        ]
    made = {_key(p): p for p in (space.at(*one) for one in wanted)}
    made.pop(_key(prior), None)
    return tuple(made.values())


def _worth(run: Selection, counted: Array) -> float:
    """Evidence of a run with rows counted alike for all, less the price of names."""
    task, members = run.task, run.fit.members
    common = fit(task.design, task.prior, members, counted, rounds=4)
    return common.score - sum(task.candidates.cost(g) + _price(g) for g in members)


def _price(group: Group) -> float:
    """What a name costs beside its choice: a link's, all that a name must win."""
    return RULES.per_link if group.effect.of_link else RULES.per_name
