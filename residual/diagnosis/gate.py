"""The gate: a name must lower the error of left-out logs; sets near the one found."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg import solve_triangular

from residual.diagnosis.result import Detectable
from residual.diagnosis.search import Task, best, least, refined, rows_of, spares_model
from residual.evidence.design import Design, Group
from residual.evidence.fit import Fit, System, gain, possible
from residual.evidence.priors import overlap, stacks
from residual.evidence.rules import RULES
from residual.recording import Array
from residual.signals.track import Track

BINS, FEWEST = 16, 8  # of a curve; rows of a bin and log that count
STATIC = "static"  # the family of torques that depend on nothing but the position


@dataclass(frozen=True, eq=False, slots=True)
class Tested:
    """One member of the chosen set after the gate."""

    group: Group  # the effect, joints and shape
    nats: float  # evidence that it carries in the whole set
    by: str | None  # "fit" or "plausibility"; None where it fails
    joint: int  # the joint (from 0) on which it matters most
    fall: float  # fall of the left-out error there, as a share of torque rms
    share: float  # part of that joint's left-out error which it removes
    # The joint (from 0) whose left-out error falls most. Without the name the
    # parameters bend, and that may show elsewhere.
    seen: int


def leave_out(task: Task, fitted: Fit) -> Array:
    """Squared error of each fold, predicted from the others. Shape (folds, dof)."""
    return left_out(task, fitted, System.of(task.design, task.prior, fitted.members))


def left_out(task: Task, fitted: Fit, whole: System) -> Array:
    """The same, of the normal equations of a fit. Shape (folds, dof)."""
    design, out = task.design, []
    weight = fitted.weight(design.rows)
    for own in whole.folds(design):
        theta, _ = replace(
            whole, gram=whole.gram - own.gram, cross=whole.cross - own.cross
        ).solve(weight)
        out.append(own.squared_error(theta))
    return np.array(out)


def gate(task: Task, fitted: Fit) -> list[Tested]:
    """Test every member of a set: left-out error, else plausibility."""
    full = leave_out(task, fitted)
    return [_test(task, fitted, group, full) for group in fitted.members]


def _test(task: Task, fitted: Fit, group: Group, full: Array) -> Tested:
    design, rules = task.design, task.rules
    rest = [g for g in fitted.members if g is not group]
    # Settled on its own noise, as a user would refit without the name: held to the
    # larger model's noise it would bend its parameters beyond belief instead.
    without = task.settle(task.fit(rest, fitted, rounds=4))
    nats, big, small = gain(design, task.prior, fitted, without)
    left = leave_out(task, without)
    power = np.maximum(design.tau_power.sum(axis=0), 1e-30)
    fall = (left - full).sum(axis=0) / power
    relative = np.sign(fall) * np.sqrt(abs(fall))
    share = 1 - full.sum(axis=0) / np.maximum(left.sum(axis=0), 1e-30)
    improved = np.mean((left > full)[_acting(design, fitted, group)], axis=0)
    acts = [j for j in range(design.dof) if len(design.present(j, group.ids)[0])]
    joint = acts[int(np.argmax(fall[acts]))]
    by = None
    if nats < least(task, fitted.members, group) or not possible(design, fitted, group):
        pass
    elif np.any(rules.lower(relative, share) & (improved >= RULES.most_folds)):
        by = "fit"
    elif spares_model(task, group, nats, big, small):
        by = "plausibility"
    at_joint = float(relative[joint]), float(share[joint])
    return Tested(group, nats, by, joint, *at_joint, int(np.argmax(fall)))


def _acting(design: Design, fitted: Fit, group: Group) -> Array:
    """Folds in which a member does anything; the others have no say. Shape (folds,).

    A sensor that saturates does so in those logs alone that ask for so much.
    """
    theta, power = fitted.of(group), np.zeros(design.folds)
    for j in range(design.dof):
        place, have = design.present(j, group.ids)
        gram, _ = design.fold_sums(j, place)
        power += (gram @ theta[have]) @ theta[have] / design.rms[j] ** 2
    return power > RULES.silent_fold * power.max()


def passed(task: Task, fitted: Fit) -> tuple[Fit, list[Tested]]:
    """Drop the members that fail, weakest first, until all pass."""
    while True:
        tested = gate(task, fitted)
        failed = [t for t in tested if t.by is None]
        if not failed:
            return fitted, tested
        worst = min(failed, key=lambda t: t.nats)
        rest = [g for g in fitted.members if g is not worst.group]
        fitted = task.settle(task.fit(rest, fitted))


def alternatives(task: Task, fitted: Fit, group: Group) -> tuple[list[Group], float]:
    """What could stand in a member's place, and how sure its class is.

    Returns:
        Candidates within 6 nats of the member when swapped in, nearest first; the
        probability of that class against every other candidate and against nothing.
    """
    if (fitted, group) not in task.alternatives:
        task.alternatives[fitted, group] = _alternatives(task, fitted, group)
    return task.alternatives[fitted, group]


def _alternatives(task: Task, fitted: Fit, group: Group) -> tuple[list[Group], float]:
    rest = [g for g in fitted.members if g is not group]
    without = task.fit(rest, fitted)
    own = task.net_gain(fitted, without, group)
    ranked = best(task, without, instead=group)
    had = np.maximum(without.sse, 1e-30)
    removed = np.maximum(without.sse - fitted.sse, 0) / had
    joint = int(np.argmax(removed))

    def stands_in(value: float, big: Fit) -> bool:
        """It explains what the member explains, and not something else beside it."""
        fall = (without.sse[joint] - big.sse[joint]) / had[joint]
        return own - value < RULES.class_nats and fall > 0.5 * removed[joint]

    near = [g for value, g, big in ranked if stands_in(value, big)]
    far = [value for value, g, _ in ranked if g not in near]
    inside = np.exp([0.0, *(min(v - own, 50) for v, g, _ in ranked if g in near)]).sum()
    outside = np.exp([min(v - own, 50) for v in [0.0, *far]]).sum()
    return near, float(inside / (inside + outside))


def simplest(task: Task, fitted: Fit) -> Fit:
    """Prefer the simpler of two names that the data cannot tell apart.

    A member gives way to an alternative with fewer coefficients and shape parameters
    that explains the same within 3 nats (odds of 20 to 1).
    """
    for group in fitted.members:
        rest = [g for g in fitted.members if g is not group]
        without = task.fit(rest, fitted)
        # Priced as if alone: one of several joints has no lead over its alternative.
        own = task.net_gain(fitted, without, replace(group, fellows=1))
        for value, other, _ in best(task, without, instead=group):
            if own - value < RULES.simpler and _size(other) < _size(group):
                stand_in = replace(other, fellows=group.fellows)
                fitted = task.settle(task.fit((*rest, stand_in), without))
                break
    return fitted


def _size(group: Group) -> float:
    """Number of free numbers of a group, and how far-fetched it is beside others."""
    shape = group.effect.refine is not None
    return len(group.ids) + shape + group.effect.far_fetched


# Names whose own curve is another: they resemble what the logs show, and are not it.
#
# A sensor with a dead zone looks like one of less gain, a stop that is leaned on like a
# spring, as long as only the error is asked. Over the variable that it is drawn against
# the name then leaves a curve that every log repeats, a third of what it explains. No
# author's form of the same effect leaves so much.


def wrong_forms(
    design: Design, tracks: Sequence[Track], fitted: Fit, tested: Sequence[Tested]
) -> list[Tested]:
    """Return the names that leave a third of their own curve or more unexplained."""
    return [t for t in tested if _is_wrong(design, tracks, fitted, t)]


def _is_wrong(
    design: Design, tracks: Sequence[Track], fitted: Fit, tested: Tested
) -> bool:
    group = tested.group
    if not group.effect.of_one_variable:
        return False
    (j,) = group.joints
    place, have = design.present(j, group.ids)
    drawn = design.columns(j, place) @ fitted.of(group)[have]
    left = design.residual(j, fitted.ids, fitted.theta)
    x, log = _variable(design, tracks, tested, j)
    curve = _repeated(x, left, log)
    return curve > max(RULES.own_curve * np.std(drawn), RULES.own_least * design.rms[j])


def _variable(
    design: Design, tracks: Sequence[Track], tested: Tested, j: int
) -> tuple[Array, Array]:
    """What the name is drawn against on the rows of a joint, and each row's log."""
    values, logs = [], []
    for i, (track, state) in enumerate(zip(tracks, design.states, strict=True)):
        x, _ = tested.group.effect.variable(state, j)
        rows = track.moving[:, j]
        values.append(x[:: track.step][rows])
        logs.append(np.full(int(rows.sum()), i))
    return np.concatenate(values), np.concatenate(logs)


def _repeated(x: Array, y: Array, log: Array) -> float:
    """Rms of the curve of y over x that one log has from the others [of y].

    Products of the means of one bin in different logs: noise, which no two logs share,
    averages out instead of adding up.
    """
    edges = np.quantile(x, np.linspace(0, 1, BINS + 1)[1:-1])
    place = np.searchsorted(edges, x)
    total, weight = 0.0, 0.0
    for b in range(BINS):
        mine = place == b
        counts = np.bincount(log[mine])
        sums = np.bincount(log[mine], y[mine], minlength=len(counts))
        enough = counts >= FEWEST
        means = sums[enough] / counts[enough]
        if len(means) > 1:
            pairs = len(means) * (len(means) - 1)
            product = (means.sum() ** 2 - (means**2).sum()) / pairs
            total += mine.sum() * product
            weight += mine.sum()
    return float(np.sqrt(max(total / weight, 0.0))) if weight else 0.0


# Names that together are but a curve: a Fourier series is no physics.
#
# A spring and ripples of several orders can draw any function of a joint's position,
# such as a stop that the arm leans on. Where a free curve of as many numbers draws it
# as well, the names say nothing that the curve does not, and none of them stands.


def only_curves(
    design: Design,
    tracks: Sequence[Track],
    fitted: Fit,
    tested: Sequence[Tested],
) -> list[Tested]:
    """Return the names that a free curve of as many numbers could stand for.

    Looked at are joints with two or more names that depend on the position alone and
    a wave that repeats among them.
    """
    out = []
    for j in range(design.dof):
        mine = [t for t in tested if t.group.joints == (j,) and _of_position(t)]
        if len(mine) > 1 and any(t.group.effect.repeats for t in mine):
            left = design.residual(j, fitted.ids, fitted.theta)
            drawn = sum(_torque(design, fitted, t, j) for t in mine)
            numbers = sum(len(t.group.ids) + len(t.group.shape) for t in mine)
            lines = [x.q[:: x.step, j][x.moving[:, j]] for x in tracks]
            rest = _without_curve(np.concatenate(lines), left + drawn, numbers)
            had = ((left + drawn) ** 2).sum()
            explained = had - (left**2).sum()
            if had - (rest**2).sum() > RULES.drawn * explained:
                out += _waves(design, fitted, mine, j, left + drawn, explained)
    return out


def _waves(
    design: Design,
    fitted: Fit,
    mine: list[Tested],
    j: int,
    whole: Array,
    explained: float,
) -> list[Tested]:
    """Those of the names on a joint that draw the curve: all, or what rides on one.

    Where one name that is no wave explains nearly all of it, it is no drawing: the
    waves are what its textbook form leaves.
    """
    for t in mine:
        left = ((whole - _torque(design, fitted, t, j)) ** 2).sum()
        alone = (whole**2).sum() - left
        if not t.group.effect.repeats and alone > RULES.drawn * explained:
            return [other for other in mine if other is not t]
    return mine


def _of_position(tested: Tested) -> bool:
    effect = tested.group.effect
    return effect.repeats or effect.family == STATIC


def _torque(design: Design, fitted: Fit, tested: Tested, j: int) -> Array:
    place, have = design.present(j, tested.group.ids)
    return design.columns(j, place) @ fitted.of(tested.group)[have]


def _without_curve(x: Array, y: Array, numbers: int) -> Array:
    """What straight lines between so many knots, evenly spaced, leave of y."""
    knots = np.linspace(x.min(), x.max(), max(numbers, 2))
    width = max(knots[1] - knots[0], 1e-12)
    hats = np.maximum(1 - abs(x[:, None] - knots) / width, 0)
    return y - hats @ np.linalg.lstsq(hats, y, rcond=None)[0]


# Sets of effects near the one that was found: better ones, and those as good.
#
# A greedy search takes one effect after another, and what two changes do together one
# of another name may do almost as well. So near its end members are swapped one for
# one, one for two and two for one, and every set pays alike:
#
# score(S) = log evidence - sum over S of (price + threshold)
#
# which is the threshold that a single name must pass, as a prior over sets.


FIRST, SECOND = 2, 1  # candidates tried for the first place and for the second
FAR = 2 * RULES.class_nats  # nats from where a set is not worth a closer look

Members = tuple[Group, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Rival:
    """Another set that the logs cannot tell from the one named."""

    members: Members  # its effects
    nats: float  # its score over that of the named set [nats]
    twin: bool = False  # whether the two differ by what these logs cannot show at all


def best_set(task: Task, fitted: Fit) -> Fit:
    """Move to a better set near the one found, as long as there is one."""
    if any(g.fellows > 1 for g in fitted.members):
        return fitted
    for _ in range(RULES.set_rounds if fitted.members else 0):
        own = _score(task, fitted)
        top = max(_near(task, fitted), key=lambda f: _score(task, f), default=fitted)
        if _score(task, top) < own + RULES.better or not _admitted(task, top):
            break
        fitted = task.settle(task.fit(top.members, top))
    return fitted


def rivals(task: Task, fitted: Fit, least: Sequence[Detectable]) -> list[Rival]:
    """Return all sets within 6 nats of the one named, nearest first."""
    if not fitted.members or any(g.fellows > 1 for g in fitted.members):
        return []
    near, twins = near_sets(task, fitted), _twins(task, fitted, least)
    known = {_places(r.members) for r in near}
    return [*near, *(r for r in twins if _places(r.members) not in known)]


def near_sets(task: Task, fitted: Fit) -> list[Rival]:
    """Return the sets of those that another motion may tell from the one named."""
    if not fitted.members or any(g.fellows > 1 for g in fitted.members):
        return []
    if fitted not in task.near_sets:
        task.near_sets[fitted] = _near_sets(task, fitted)
    return task.near_sets[fitted]


def _near_sets(task: Task, fitted: Fit) -> list[Rival]:
    own, found = _score(task, fitted), {}
    for other in _near(task, fitted):
        gap = _score(task, other) - own
        key = _places(other.members)
        if gap > -RULES.class_nats and key != _places(fitted.members):
            known = found.get(key)
            if known is None or gap > known.nats:
                found[key] = Rival(other.members, gap)
    return sorted(found.values(), key=lambda r: -r.nats)


def _near(task: Task, fitted: Fit) -> Iterator[Fit]:
    """Sets one move away: another for one, two for one, one for two, one less."""
    members = fitted.members
    for group in members:
        rest = tuple(g for g in members if g is not group)
        without = task.fit(rest, fitted)
        yield without
        for _, other, _ in best(task, without, instead=group)[:FIRST]:
            swapped = _with(task, rest, other, without)
            yield swapped
            for _, second, _ in _others(task, swapped, (group,))[:SECOND]:
                yield _with(task, swapped.members, second, swapped)
    for one, two in combinations(members, 2):
        if _meet(task, one, two):
            rest = tuple(g for g in members if g is not one and g is not two)
            without = task.fit(rest, fitted)
            for _, other, _ in _others(task, without, (one, two))[:FIRST]:
                yield _with(task, rest, other, without)


def _others(task: Task, base: Fit, gone: Sequence[Group]) -> list:
    """Candidates on top of a fit that are none of those taken out."""
    keys = {g.key for g in gone}
    ranked = best(task, base)
    return [one for one in ranked if not one[1].parts and one[1].key not in keys]


def _with(task: Task, rest: Sequence[Group], other: Group, like: Fit) -> Fit:
    return task.fit(refined(task, (*rest, other), like), like)


def _meet(task: Task, one: Group, two: Group) -> bool:
    """Whether two effects act on a joint together."""
    return bool(rows_of(task, one) & rows_of(task, two))


def _score(task: Task, fitted: Fit) -> float:
    price = sum(task.candidates.cost(g) + task.rules.threshold for g in fitted.members)
    return fitted.score - price


def _admitted(task: Task, fitted: Fit) -> bool:
    return all(possible(task.design, fitted, g) for g in fitted.members)


def _places(members: Sequence[Group]) -> tuple:
    return tuple(sorted((g.effect.name, g.joints) for g in members))


def _twins(task: Task, fitted: Fit, least: Sequence[Detectable]) -> list[Rival]:
    """Sets with one more change of a body that the named ones take up unseen.

    A smaller load and a heavier link do what a load does; no evidence chooses, only
    the price of one more name.
    """
    heavy = [g for g in fitted.members if g.effect.portable.bodies is not None]
    taken = _places(fitted.members)
    others = [
        g
        for g in task.candidates.groups
        if g.effect.portable.bodies is not None
        and not g.parts
        and (g.effect.name, g.joints) not in taken
        and len(g.ids) == 1
    ]
    if not heavy or not others:
        return []
    rest = [g for g in fitted.members if g not in heavy]
    alone = _information(task, fitted, rest, others)
    beside = _information(task, fitted, fitted.members, others)
    out = []
    for other, before, after in zip(others, alone, beside, strict=True):
        cost = task.candidates.cost(other) + task.rules.threshold
        # Clear without the named bodies, which take it up: not to be found beside them.
        clear, taken_up = (
            0.5 * RULES.told_apart**2 * before > cost,
            after < RULES.taken * before,
        )
        if clear and taken_up and _unseen(other, least):
            out.append(Rival((*fitted.members, other), -cost, twin=True))
    return out


def _unseen(other: Group, least: Sequence[Detectable]) -> bool:
    """Whether a usual change of a body would not be found."""
    place = other.effect.name, tuple(j + 1 for j in other.joints)
    sizes = [d.value for d in least if (d.name, d.joints) == place]
    return not any(size is not None and size < RULES.told_apart for size in sizes)


def _information(
    task: Task, fitted: Fit, members: Sequence[Group], others: Sequence[Group]
) -> Array:
    """What logs hold of each candidate that a set cannot take up. Shape (g,)."""
    weight = fitted.weight(task.design.rows)
    system = System.of(task.design, task.prior, members)
    shared = overlap(task.design, system, weight)
    half = solve_triangular(system.solve(weight)[1], shared, lower=True)
    out = np.empty(len(others))
    for stack in stacks(task.design, others):
        out[stack.members] = stack.beyond(weight, half)[:, 0, 0]
    return out
