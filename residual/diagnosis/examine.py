"""Diagnosis of one set of logs: what the nominal model lacks on them."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.adequacy import Adequacy, adequacy, carried
from residual.diagnosis.candidates import Candidates, every_candidate, renewed
from residual.diagnosis.causes.sets import best_set
from residual.diagnosis.gate import KIN, Tested, passed, simplest
from residual.diagnosis.prior_scale import Selection, select
from residual.diagnosis.search import refined, search
from residual.diagnosis.task import Rules, Task
from residual.effects import registry
from residual.evidence.design import Design, Group
from residual.evidence.fit import Fit, Prior, fit
from residual.evidence.priors import Space
from residual.evidence.states import as_model, first_design, physical
from residual.model.compare import HeldOutLog, moving_error
from residual.model.model import Model
from residual.model.nominal import Logs, Nominal
from residual.model.standstill import with_standstill
from residual.recording import Array
from residual.signals.track import Track

BINS = 16
PART = 0.35  # of the name's own torque on those rows
LEAST = 0.005  # of the joint's torque: what a model of any arm leaves
FEWEST = 8  # rows of a bin and log that count


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
    return curve > max(PART * np.std(drawn), LEAST * design.rms[j])


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


STATIC = "static"  # the family of torques that depend on nothing but the position


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
            if had - (rest**2).sum() > KIN * explained:
                out += _waves(design, fitted, (mine, j), (left + drawn, explained))
    return out


def _waves(design: Design, fitted: Fit, names, target) -> list[Tested]:
    """Those of the names on a joint that draw the curve: all, or what rides on one.

    Where one name that is no wave explains nearly all of it, it is no drawing: the
    waves are what its textbook form leaves.
    """
    (mine, j), (whole, explained) = names, target
    for t in mine:
        left = ((whole - _torque(design, fitted, t, j)) ** 2).sum()
        alone = (whole**2).sum() - left
        if not t.group.effect.repeats and alone > KIN * explained:
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


Progress = Callable[[str, float], None]
LOOKS = 4  # at what was named, before the second search
STEADY = 0.1  # nats by which one more look at it changes nothing
MOST_OF_IT = 0.75  # of what was left of a joint that keeps more than any model may
LARGE = 0.05  # an effect of this share of torque rms shifts model-based features


@dataclass(frozen=True, eq=False, slots=True)
class Examined:
    """What one set of logs says.

    Attributes:
        logs: The fit logs.
        nominal: Where it started from.
        task: Data, chosen prior and candidates.
        wide: The widest prior that the logs do not contradict.
        plain: Fit of the nominal structure alone.
        fit: Fit with the named effects.
        tested: The named effects with their evidence.
        withdrawn: Names that merely resemble what flagged joints show.
        adequacy: What remains.
    """

    logs: Logs
    nominal: Nominal
    task: Task
    wide: Prior
    plain: Fit
    fit: Fit
    tested: tuple[Tested, ...]
    withdrawn: tuple[Tested, ...]
    adequacy: Adequacy

    def error(self, fitted: Fit, held_out: Sequence[HeldOutLog]) -> Array:
        """Squared error of a fit on moving rows by second [N^2 m^2]. (seconds, dof)."""
        return moving_error(as_model(self.nominal, fitted), held_out)

    def model(self, fitted: Fit, like: Model | None = None) -> Model:
        """A fit as a model, with the standstill that suits the fit logs.

        Args:
            like: A model whose standstill to take over, so that two models differ by
                nothing but their effects.
        """
        rough = as_model(self.nominal, fitted)
        if like is not None:
            rough = replace(rough, standstill=like.standstill)
        else:
            rough = with_standstill(rough, self.logs.sketch)
        return _refitted(self, fitted, rough)


def examine(
    logs: Logs,
    nominal: Nominal,
    rules: Rules,
    progress: Progress,
    closed: Collection[int] = (),
) -> Examined:
    """Search, test and flag.

    Args:
        progress: Told the stage and the share done.
        closed: Joints (from 0) of which nothing of their own may be named.
    """
    design = first_design(logs, nominal)
    progress("features", 0.0)
    everything = every_candidate(design, nominal, logs.span, logs.clock is not None)
    everything = everything.closing(closed)
    selection = _search(design, nominal, everything, (rules, progress))
    if _needs_second_search(selection):
        settled = _refit_named(logs, nominal, selection)
        design.show_torque(physical(as_model(nominal, settled)))
        progress("features", 0.5)
        everything = renewed(design, everything)
        prior, wide = selection.task.prior, selection.wide
        again = replace(nominal, scale=prior.scale, widths=prior.widths)
        selection = _search(design, again, everything, (rules, progress))
        selection = replace(selection, wide=wide)
    found = best_set(selection.task, selection.fit)
    selection = replace(selection, fit=found)
    progress("gate", 0.0)
    examined = _tested(logs, nominal, selection)
    progress("gate", 1.0)
    return examined


def search_again(
    examined: Examined, fallen: Sequence[Group], kin: Sequence[Group]
) -> Examined:
    """Search the same logs again without some names; every other one is tested anew.

    What a name has carried falls with it: a delay that was none must not leave the
    friction behind that it made room for. And what it hid may be found now.

    Args:
        examined: The diagnosis so far; its prior is kept.
        fallen: What may not be named any more.
    """
    task = examined.task
    task = replace(task, candidates=task.candidates.barring(fallen, kin))
    gone = {(g.effect.name, g.joints) for g in fallen}
    members = examined.fit.members
    left = [g for g in members if (g.effect.name, g.joints) not in gone]
    selection = Selection(task, task.settle(search(task, left)), examined.wide)
    return _tested(examined.logs, examined.nominal, selection)


def _tested(logs: Logs, nominal: Nominal, selection: Selection) -> Examined:
    """Put what a search found through the gate, and measure what remains."""
    task, design = selection.task, selection.task.design
    fitted, tested = passed(task, simplest(task, selection.fit))
    curved = only_curves(design, logs.sketch, fitted, tested)
    if curved:
        real = [t.group for t in tested if t not in curved]
        fitted = task.settle(task.fit(real, fitted))
    plain = task.settle(task.fit((), fitted, rounds=4))
    enough = _adequacy(logs, nominal, design, (plain, fitted))
    wrong = [*curved, *wrong_forms(design, logs.sketch, fitted, tested)]
    kept = [t for t in tested if t not in wrong and not _resembles(t, enough)]
    if len(kept) < len(tested):
        fitted = task.settle(task.fit([t.group for t in kept], fitted))
    gone = tuple(t for t in tested if t not in kept)
    return Examined(
        logs, nominal, task, selection.wide, plain, fitted, tuple(kept), gone, enough
    )


def _adequacy(
    logs: Logs, nominal: Nominal, design: Design, fits: tuple[Fit, Fit]
) -> Adequacy:
    """What is left of the logs, beside the noise of torque and angles."""
    angles = carried(as_model(nominal, fits[1]), logs.sketch, logs.shaken)
    return adequacy(design, logs.sketch, *fits, angles)


def _search(
    design: Design, nominal: Nominal, everything: Candidates, options
) -> Selection:
    rules, progress = options
    space = Space(design, nominal)
    return select(space, everything, rules, lambda share: progress("search", share))


def _needs_second_search(selection: Selection) -> bool:
    """Did a large effect, or one that reads the model's torque, get accepted?"""
    fitted, task = selection.fit, selection.task
    if not fitted.members:
        return False
    if any(g.effect.uses_model for g in fitted.members):
        return True
    plain = task.fit((), fitted, rounds=4)
    fall = np.maximum(plain.sse - fitted.sse, 0) / task.design.rows
    model_based = any(e.uses_model for e in registry().values())
    return model_based and bool(np.max(np.sqrt(fall) / task.design.rms) > LARGE)


def _refit_named(logs: Logs, nominal: Nominal, selection: Selection) -> Fit:
    """The named effects on columns of a model that has them: Gauss and Newton's way.

    A log that ends at a certain torque bends the model that its plateau is held
    against; so does a load that is still missing.
    """
    task, fitted = selection.task, selection.fit
    design = task.design
    for _ in range(LOOKS):
        design.show_torque(physical(as_model(nominal, fitted)))
        members = design.add([(g.effect, g.joints, g.shape) for g in fitted.members])
        for group in [g for g in members if g.effect.uses_model and g.effect.refine]:
            others = [g for g in members if g is not group]
            members = refined(task, (*others, group), fitted)
        before, fitted = fitted.score, task.fit(members, fitted)
        if abs(fitted.score - before) < STEADY:
            break
    return fitted


def _resembles(tested: Tested, enough: Adequacy) -> bool:
    """A name on a joint that keeps much may be a part of what is not known.

    On a flagged joint it must explain 3/4 of what was left. What claims the whole arm
    must explain more than remains of a doubted one, too; of one joint's own friction or
    constant that was asked once, and cost true names only (docs/benchmarks.md).
    """
    local = tested.group.effect.scope in ("local", "pair")
    joints = set(tested.group.joints if local else (tested.joint,))
    if joints & set(enough.flagged) and tested.share < MOST_OF_IT:
        return True
    doubted = set() if local else joints & set(enough.doubted)
    return any(tested.fall < enough.structured[j] for j in doubted)


def _refitted(examined: Examined, fitted: Fit, rough: Model) -> Model:
    """Coefficients that go with a model's standstill and its own torque.

    A wide standstill changes friction on slow moving rows too, and features such as
    load friction read the model's torque: both are settled by one more fit.
    """
    nominal, tracks = examined.nominal, examined.logs.tracks
    base = replace(nominal.model, standstill=rough.standstill)
    design = Design(tracks, base, seen_with=rough)
    members = design.add([(g.effect, g.joints, g.shape) for g in fitted.members])
    final = fit(design, examined.task.prior, members, fitted.counted, fitted.variance)
    return as_model(replace(nominal, model=base), final)


def without_refuted(examined: Examined, fitted: Fit) -> Examined:
    """The diagnosis with fewer names: what remains is measured anew."""
    if len(fitted.members) == len(examined.fit.members):
        return examined
    fits = examined.plain, fitted
    design = examined.task.design
    enough = _adequacy(examined.logs, examined.nominal, design, fits)
    return replace(examined, fit=fitted, adequacy=enough)


def refit(examined: Examined, tested: Sequence[Tested]) -> Fit:
    """Fit again with some of the names only."""
    task = examined.task
    members = [t.group for t in tested]
    return task.settle(
        fit(task.design, task.prior, members, examined.fit.counted, None, rounds=4)
    )
