"""The outcome of one set of logs: the named effects, the fits with and without them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from residual.diagnosis.adequacy import Adequacy, assess_adequacy, torque_from_angle_noise
from residual.diagnosis.candidates import Candidates
from residual.diagnosis.score import Score
from residual.diagnosis.select import Member, Selection, select_names
from residual.effects.base import EffectTrait
from residual.evidence.design import Design
from residual.evidence.fit import (
    Fit,
    NominalPrior,
    PossibleModel,
    build_fitted_model,
    fit_jointly,
    fit_possible_bodies,
)
from residual.evidence.priors import hold_coefficients, list_contradicted_coefficients
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import HeldOutLog, compute_moving_error
from residual.model.model import Model
from residual.model.nominal import FitLogs, NominalModel, choose_standstill_behaviour
from residual.recording import Array

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False, slots=True)
class Outcome:
    """The outcome of one set of logs."""

    logs: FitLogs  # the fit logs
    nominal: NominalModel  # the nominal model
    selection: Selection  # data, prior, candidates and all names with probability
    plain: Fit  # fit of the nominal structure alone
    fit: Fit  # fit with the named effects
    named: tuple[Member, ...]  # those certain enough for the model
    adequacy: Adequacy  # the residual
    # The model with names of bodies, if the logs contradict every possible body.
    impossible: PossibleModel | None = None

    @property
    def score(self) -> Score:
        """Data and prior."""
        return self.selection.search.score

    @property
    def design(self) -> Design:
        """Columns and rows."""
        return self.score.design

    @property
    def prior(self) -> NominalPrior:
        """Prior of the nominal model."""
        return self.score.prior

    @property
    def candidates(self) -> Candidates:
        """The candidates under that prior."""
        return self.selection.search.candidates

    @property
    def suspected(self) -> tuple[Member, ...]:
        """Names more likely than not, but in no model."""
        return tuple(
            m
            for m in self.selection.members
            if m not in self.named and m.probability >= THRESHOLDS.min_probability
        )

    def error(self, fitted: Fit, held_out: Sequence[HeldOutLog]) -> Array:
        """Squared error of a fit on moving rows by second [N^2 m^2]. (seconds, dof)."""
        return compute_moving_error(build_fitted_model(self.nominal, fitted), held_out)

    def refit(self, members: Sequence[Member]) -> Fit:
        """Fit again with some of the names only."""
        if tuple(m.group for m in members) == self.fit.members:
            return self.fit
        return self.score.fit([m.group for m in members], self.fit)

    def with_names(self, named: Sequence[Member]) -> "Outcome":
        """The outcome with other names in the model."""
        fitted = self.refit(named)
        adequacy = self.assess(fitted)
        return replace(self, named=tuple(named), fit=fitted, adequacy=adequacy)

    def assess(self, fitted: Fit) -> Adequacy:
        """Assess the residual of a fit."""
        return _assess(self.logs, self.nominal, self.design, self.plain, fitted)

    def possible(self) -> PossibleModel:
        """The fit with the named effects, with the nearest possible bodies."""
        model = build_fitted_model(self.nominal, self.fit)
        return fit_possible_bodies(self.design, self.fit, model)

    def fit_at_nominal(self, member: Member) -> Fit | None:
        """The fit without a wrong value, with only that value held as given.

        For a body all bodies are held, since its neighbours would imitate it. None if
        the name is no value of the model.
        """
        slots = list_contradicted_coefficients(self.nominal.model, member.group)
        if not len(slots):
            return None
        prior = hold_coefficients(self.prior, slots)
        members = [m.group for m in self.named if m is not member]
        return replace(self.score, prior=prior).fit(members, self.fit)

    def model(self, fitted: Fit, like: Model | None = None) -> PossibleModel:
        """A fit as a model of possible bodies, with the standstill of the fit logs.

        Args:
            like: A model whose standstill to copy, so that two models differ only in
                their effects.
        """
        rough = build_fitted_model(self.nominal, fitted)
        if like is None:
            rough = choose_standstill_behaviour(rough, self.logs.tracks)
        else:
            rough = replace(rough, standstill=like.standstill)
        # A wide standstill changes friction on slow moving rows too, and features such
        # as load friction use the model's torque: one more fit settles both.
        base = replace(self.nominal.model, standstill=rough.standstill)
        design = Design(self.logs.tracks, base, seen_with=rough)
        members = design.add([g.placed for g in fitted.members])
        final = fit_jointly(design, self.prior, members, fitted.counted, fitted.variance)
        model = build_fitted_model(replace(self.nominal, model=base), final)
        return fit_possible_bodies(design, final, model)


def search_effects(logs: FitLogs, nominal: NominalModel, progress: Progress) -> Outcome:
    """Search for effects missing in the nominal model, and assess the residual."""
    progress("search", 0.0)
    selection = select_names(logs, nominal, lambda share: progress("search", share))
    nominal = nominal.without_constants()
    score, fitted = selection.search.score, selection.fit
    plain = score.fit((), fitted)
    every = selection.members
    named = tuple(m for m in every if m.probability >= THRESHOLDS.sure_probability)
    if len(named) < len(fitted.members):
        fitted = score.fit([m.group for m in named], fitted)
    adequacy = _assess(logs, nominal, score.design, plain, fitted)
    outcome = Outcome(logs, nominal, selection, plain, fitted, named, adequacy)
    return leave_out_impossible_bodies(outcome)


def leave_out_impossible_bodies(outcome: Outcome) -> Outcome:
    """Remove names of bodies if the logs contradict every possible body."""
    others = [m for m in outcome.named if EffectTrait.BODY not in m.group.effect.traits]
    if len(others) == len(outcome.named):
        return outcome
    possible = outcome.possible()
    if not possible.contradicted:
        return outcome
    return replace(outcome.with_names(others), impossible=possible)


def _assess(
    logs: FitLogs, nominal: NominalModel, design: Design, plain: Fit, fitted: Fit
) -> Adequacy:
    angles = torque_from_angle_noise(build_fitted_model(nominal, fitted), logs.tracks, logs.shaken)
    return assess_adequacy(design, logs.tracks, plain, fitted, angles)
