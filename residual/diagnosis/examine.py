"""Diagnosis of one set of logs: what the nominal model lacks on them."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.adequacy import Adequacy, adequacy, carried
from residual.diagnosis.candidates import Candidates, every_candidate, renewed
from residual.diagnosis.causes.sets import best_set
from residual.diagnosis.gate import Tested, passed, simplest, wrong_forms
from residual.diagnosis.prior_scale import Selection, select
from residual.diagnosis.search import Task, refined, search
from residual.effects import registry
from residual.evidence.design import Design, Group
from residual.evidence.fit import Fit, Prior, as_model, fit, physical
from residual.evidence.priors import Space, first_design
from residual.evidence.rules import RULES, Rules
from residual.model.compare import HeldOutLog, moving_error
from residual.model.model import Model
from residual.model.nominal import Logs, Nominal, with_standstill
from residual.recording import Array

Progress = Callable[[str, float], None]


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
    plain = task.settle(task.fit((), fitted, rounds=4))
    enough = _adequacy(logs, nominal, design, (plain, fitted))
    wrong = wrong_forms(design, logs.sketch, fitted, tested)
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
    return model_based and bool(np.max(np.sqrt(fall) / task.design.rms) > RULES.large)


def _refit_named(logs: Logs, nominal: Nominal, selection: Selection) -> Fit:
    """The named effects on columns of a model that has them: Gauss and Newton's way.

    A log that ends at a certain torque bends the model that its plateau is held
    against; so does a load that is still missing.
    """
    task, fitted = selection.task, selection.fit
    design = task.design
    for _ in range(RULES.looks):
        design.show_torque(physical(as_model(nominal, fitted)))
        members = design.add([(g.effect, g.joints, g.shape) for g in fitted.members])
        for group in [g for g in members if g.effect.uses_model and g.effect.refine]:
            others = [g for g in members if g is not group]
            members = refined(task, (*others, group), fitted)
        before, fitted = fitted.score, task.fit(members, fitted)
        if abs(fitted.score - before) < RULES.steady:
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
    if joints & set(enough.flagged) and tested.share < RULES.most_of_it:
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
