"""Fit the true effects with their values free: the reference for a diagnosis.

Logs, model, prior and fit are those of the diagnosis, but effects and joints are given
instead of searched. A diagnosis that predicts as well has lost nothing by the search.
"""

from collections.abc import Sequence

import numpy as np

from residual.diagnosis.candidates import Candidates
from residual.diagnosis.outcome import Outcome
from residual.diagnosis.score import Score, label_blocks
from residual.diagnosis.search import Search, refine_last_shape
from residual.diagnosis.select import Selection
from residual.effects import load_effects
from residual.effects.base import Effect, Joints, PlacedEffect
from residual.errors import check_name
from residual.evidence.columns import CandidateColumns
from residual.evidence.design import Design
from residual.evidence.fit import (
    Fit,
    build_fitted_model,
    fit_jointly,
    fit_nominal,
    keep_physical_terms,
)
from residual.evidence.priors import build_relative_prior, list_first_priors
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import ErrorSums, compute_model_errors, prepare_held_out
from residual.model.model import Model
from residual.model.nominal import (
    FitLogs,
    NominalModel,
    build_free_nominal,
    choose_declared_effects,
    prepare_fit_logs,
)
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.splitting import find_session_start
from residual.signals.track import FilterSettings

Told = tuple[str, tuple[int, ...]]


def oracle(
    robot: Robot,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    effects: Sequence[Told],
) -> tuple[Model, ErrorSums]:
    """Fit the effects that one is told of, and predict the held-out logs.

    Args:
        effects: Name and joints, from 1, of each missing effect.

    Raises:
        UnknownNameError: If there is no such effect.
    """
    clock = find_session_start([*recordings, *held_out])
    logs = prepare_fit_logs(robot, recordings, clock, FilterSettings())
    nominal = build_free_nominal(logs, choose_declared_effects(robot, None))
    wanted = [pair for told in effects for pair in placed(*told, robot.dof)]
    design = Design(logs.tracks, nominal.model, labels=label_blocks(logs.tracks))
    first = build_relative_prior(design, nominal, THRESHOLDS.rough_scale)
    design.set_torque_model(build_fitted_model(nominal, fit_nominal(design, first)))
    score, fitted = _best(design, logs, nominal, wanted)
    if wanted:
        # As after a find: features that read the model's torque are made of the better.
        named = keep_physical_terms(build_fitted_model(nominal, fitted))
        design.set_torque_model(named)
        score, fitted = _best(design, logs, nominal, wanted)
    search = Search(score, Candidates((), {}), ())
    told = Selection(search, fitted, (), (), score.prior.scale, score.prior)
    # Without an adequacy: nobody asks this one what is left.
    found = Outcome(logs, nominal, told, fitted, fitted, (), adequacy=None)
    model = found.model(fitted).model
    proof = prepare_held_out(held_out, nominal.model)
    errors, _ = compute_model_errors({"told": model}, proof, FilterSettings())
    return model, errors["told"]


def placed(name: str, joints: Sequence[int], dof: int) -> list[tuple[Effect, Joints]]:
    """Return an effect with the joints (from 0) of each of its candidates.

    Args:
        joints: From 1.
    """
    effect = load_effects()[check_name(name, load_effects(), "effect")]
    on = tuple(sorted(j - 1 for j in joints))
    if effect.scope in ("global", "flange"):
        return [(effect, *effect.candidates(dof))]
    return [(effect, on)] if effect.scope == "pair" else [(effect, (j,)) for j in on]


def _best(
    design: Design, logs: FitLogs, nominal: NominalModel, wanted: Sequence[tuple[Effect, Joints]]
) -> tuple[Score, Fit]:
    """Return the fit under the prior that these logs are likeliest under."""
    # Columns do not depend on the prior: made anew for each of a score of priors, they
    # would fill the memory. Of each effect those of every shape that a search begins
    # with.
    grid = []
    for effect, joints in wanted:
        shapes = effect.shapes(logs.span, joints[0] if joints else 0)
        grid.append(design.add([PlacedEffect(effect, joints, s) for s in shapes]))
    scores = [Score(design, prior) for prior in list_first_priors(design, nominal)]
    return _likeliest([(score, _fitted(score, grid)) for score in scores])


def _fitted(score: Score, grid: Sequence[Sequence[CandidateColumns]]) -> Fit:
    """Fit all of them, the shape of each searched as in a diagnosis."""
    current = score.fit(())
    for groups in grid:
        trials = [score.fit((*current.members, g), current) for g in groups]
        _, best = _likeliest([(score, trial) for trial in trials])
        current = score.fit(refine_last_shape(score, best.members, best), best)
    return current


def _likeliest(runs: Sequence[tuple[Score, Fit]]) -> tuple[Score, Fit]:
    """The fit with the most evidence, where as many rows count for all."""
    counted = np.max([fitted.counted for _, fitted in runs], axis=0)
    worth = [
        fit_jointly(score.design, score.prior, fitted.members, counted, fitted.variance, 4).score
        for score, fitted in runs
    ]
    return runs[int(np.argmax(worth))]
