"""Diagnosis of one set of logs: what the nominal model lacks on them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.adequacy import Adequacy, adequacy
from residual.candidates import Candidates
from residual.choices import allowed, every_candidate
from residual.design import Design
from residual.effects import registry
from residual.effects.base import Span
from residual.evidence import Fit, Prior, fit
from residual.gate import Tested, passed, simplest
from residual.model import Model, Term
from residual.nominal import build_nominal
from residual.prior import Nominal, priors, relative_prior
from residual.recording import Recording
from residual.robot import Robot
from residual.search import Rules, Task, refined, start
from residual.select import Selection, select
from residual.series import only_curves
from residual.settle import with_standstill
from residual.signals import Filters, Track, prepare

Progress = Callable[[str, float], None]
ROUGH_SCALE = 0.1  # prior of the first fit, which only feeds model-based features
LOOKS = 4  # at what was named, before the second search
STEADY = 0.1  # nats by which one more look at it changes nothing
LARGE = 0.05  # an effect of this share of torque rms shifts model-based features


@dataclass(frozen=True, eq=False, slots=True)
class Logs:
    """Fit logs, ready: signals, session clock and how far they move the arm."""

    robot: Robot
    tracks: tuple[Track, ...]
    clock: float | None
    span: Span
    speed_floor: np.ndarray
    filters: Filters


@dataclass(frozen=True, eq=False, slots=True)
class Diagnosis:
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

    def model(self, fitted: Fit, like: Model | None = None) -> Model:
        """A fit as a model, with the standstill that suits the fit logs.

        Args:
            fitted: A fit of these logs.
            like: A model whose standstill to take over, so that two models differ by
                nothing but their effects.
        """
        rough = as_model(self.nominal, fitted)
        if like is None:
            rough = with_standstill(rough, self.logs.tracks)
        else:
            rough = replace(rough, standstill=like.standstill)
        return _refitted(self, fitted, rough)


def ready(
    robot: Robot,
    recordings: Sequence[Recording],
    clock: float | None,
    filters: Filters,
) -> Logs:
    """Prepare the signals of the fit logs."""
    tracks, floor = prepare(recordings, filters)
    q = np.concatenate([t.q for t in tracks])
    qd = np.concatenate([t.qd for t in tracks])
    tau = np.concatenate([t.tau for t in tracks])
    last = max(t.t[-1] for t in tracks)
    span = Span(
        speed=np.quantile(np.abs(qd), 0.95, axis=0),
        travel=np.ptp(q, axis=0),
        duration=0.0 if clock is None else float(last - clock),
        cutoff=min(t.cutoff for t in tracks),
        torque=np.quantile(np.abs(tau), 0.995, axis=0),
    )
    return Logs(robot, tracks, clock, span, floor, filters)


def start_nominal(logs: Logs, names: Sequence[str]) -> Nominal:
    """The user's model, on the clock and thresholds of these logs."""
    nominal = build_nominal(
        logs.robot, names, logs.span, logs.speed_floor, logs.filters
    )
    return replace(nominal, model=replace(nominal.model, clock=logs.clock))


def diagnose(
    logs: Logs, nominal: Nominal, rules: Rules, progress: Progress
) -> Diagnosis:
    """Search, test and flag.

    Args:
        logs: Fit logs.
        nominal: The model to be doubted.
        rules: Thresholds.
        progress: Told the stage and the share done.
    """
    design = first_look(logs, nominal)
    selection = _search(design, logs, nominal, (rules, progress))
    if _needs_second_look(selection):
        settled = _looked_again(logs, nominal, selection)
        named = physical(as_model(nominal, settled))
        design = first_look(logs, nominal, named)
        prior = selection.task.prior
        again = replace(nominal, scale=prior.scale, assumed=prior.assumed)
        wide = selection.wide
        selection = replace(_search(design, logs, again, (rules, progress)), wide=wide)
    progress("gate", 0.0)
    task = selection.task
    fitted, tested = passed(task, simplest(task, selection.fit))
    curved = only_curves(design, logs.tracks, fitted, tested)
    if curved:
        real = [t.group for t in tested if t not in curved]
        fitted = task.settle(task.fit(real, fitted))
    plain = task.settle(task.fit((), fitted, rounds=4))
    enough = adequacy(design, logs.tracks, plain, fitted, nominal.baseline_unexplained)
    kept = [t for t in tested if t not in curved and not _resembles(task, t, enough)]
    if len(kept) < len(tested):
        fitted = task.settle(task.fit([t.group for t in kept], fitted))
    gone = tuple(t for t in tested if t not in kept)
    progress("gate", 1.0)
    return Diagnosis(
        logs, nominal, task, selection.wide, plain, fitted, tuple(kept), gone, enough
    )


def first_look(logs: Logs, nominal: Nominal, named: Model | None = None) -> Design:
    """Nominal columns, and features seen with a model that fits these logs roughly.

    Args:
        logs: The logs.
        nominal: The model to be doubted.
        named: A model to see features with instead, such as one with what was named.
    """
    states = [nominal.model.observe(t) for t in logs.tracks]
    design = Design(list(zip(logs.tracks, states, strict=True)), nominal.model)
    if named is None:
        if nominal.covariance is None:
            prior = relative_prior(design, nominal, ROUGH_SCALE)
        else:
            (prior,) = priors(design, nominal)
        named = as_model(nominal, _rough_fit(design, prior))
    design.look(
        [
            named.observe(t, s.regressor)
            for t, s in zip(logs.tracks, states, strict=True)
        ]
    )
    return design


def _rough_fit(design: Design, prior) -> Fit:
    return start(Task(design, prior, Candidates((), {}), Rules()))


def _search(design: Design, logs: Logs, nominal: Nominal, options) -> Selection:
    rules, progress = options
    progress("features", 0.0)
    clocked = logs.clock is not None
    everything = every_candidate(design, nominal, logs.span, clocked)
    pairs = allowed(design, nominal, everything)
    return select(design, pairs, rules, lambda share: progress("search", share))


def _needs_second_look(selection: Selection) -> bool:
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


def _looked_again(logs: Logs, nominal: Nominal, selection: Selection) -> Fit:
    """The named effects on columns of a model that has them: Gauss and Newton's way.

    A log that ends at a certain torque bends the model that its plateau is held
    against; so does a load that is still missing.
    """
    task, fitted = selection.task, selection.fit
    design = task.design
    for _ in range(LOOKS):
        named = physical(as_model(nominal, fitted))
        states = [s.regressor for s in design.states]
        design.look(
            [named.observe(t, r) for t, r in zip(logs.tracks, states, strict=True)]
        )
        members = design.add([(g.effect, g.joints, g.shape) for g in fitted.members])
        for group in [g for g in members if g.effect.uses_model and g.effect.refine]:
            others = [g for g in members if g is not group]
            members = refined(task, (*others, group), fitted)
        before, fitted = fitted.score, task.fit(members, fitted)
        if abs(fitted.score - before) < STEADY:
            break
    return fitted


def physical(model: Model) -> Model:
    """Only what has a physical parameter in it: loads, friction levels, rotors.

    A feature that reads the model's torque must not carry the shape of another finding:
    a torque gain times a found warm-up would explain the warm-up.
    """
    terms = tuple(t for t in model.terms if t.effect.is_parameter)
    return replace(model, terms=terms)


def _resembles(task: Task, tested: Tested, enough: Adequacy) -> bool:
    """A name on a joint that keeps more than it may be a part of what is not known.

    On a flagged joint it must explain 3/4 of what was left; on a doubted one, more of
    the torque than it leaves beyond noise.
    """
    effect = tested.group.effect
    local = effect.scope in ("local", "pair")
    joints = set(tested.group.joints if local else (tested.joint,))
    if joints & set(enough.flagged) and tested.share < 0.75:
        return True
    doubted = joints & set(enough.doubted)
    return any(tested.fall < enough.structured[j] for j in doubted)


def as_model(nominal: Nominal, fitted: Fit) -> Model:
    """Nominal model moved by a fit's coefficients, its members added as terms."""
    base = nominal.model
    count = len(base.coefficients())
    moved = base.with_coefficients(base.coefficients() + fitted.theta[:count])
    found = tuple(
        Term(g.effect, g.joints, g.shape, fitted.of(g)) for g in fitted.members
    )
    return replace(moved, terms=(*moved.terms, *found))


def _refitted(diagnosis: Diagnosis, fitted: Fit, rough: Model) -> Model:
    """Coefficients that go with a model's standstill and its own torque.

    A wide standstill changes friction on slow moving rows too, and features such as
    load friction read the model's torque: both are settled by one more fit.
    """
    nominal, tracks = diagnosis.nominal, diagnosis.logs.tracks
    base = replace(nominal.model, standstill=rough.standstill)
    states = [rough.observe(t) for t in tracks]
    design = Design(list(zip(tracks, states, strict=True)), base)
    members = design.add([(g.effect, g.joints, g.shape) for g in fitted.members])
    final = fit(design, diagnosis.task.prior, members, fitted.counted, fitted.variance)
    return as_model(replace(nominal, model=base), final)


def without_refuted(diagnosis: Diagnosis, fitted: Fit) -> Diagnosis:
    """The diagnosis with fewer names: what remains is measured anew."""
    if len(fitted.members) == len(diagnosis.fit.members):
        return diagnosis
    enough = adequacy(
        diagnosis.task.design,
        diagnosis.logs.tracks,
        diagnosis.plain,
        fitted,
        diagnosis.nominal.baseline_unexplained,
    )
    return replace(diagnosis, fit=fitted, adequacy=enough)


def refit(diagnosis: Diagnosis, tested: Sequence[Tested]) -> Fit:
    """Fit again with some of the names only."""
    task = diagnosis.task
    members = [t.group for t in tested]
    return task.settle(
        fit(task.design, task.prior, members, diagnosis.fit.counted, None, rounds=4)
    )
