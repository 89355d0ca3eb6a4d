"""Fit the true effects with their values free: the reference for a diagnosis.

Logs, model, prior and fit are those of the diagnosis, but effects and joints are given
instead of searched. A diagnosis that predicts as well has lost nothing by the search.
"""

from collections.abc import Sequence

import numpy as np

from residual.diagnosis.outcome import SearchOutcome
from residual.diagnosis.search import Candidates, SearchTask, refine_last_shape
from residual.effects import load_effects
from residual.effects.base import Effect, Joints, PlacedEffect
from residual.errors import check_name
from residual.evidence.columns import CandidateColumns
from residual.evidence.design import Design
from residual.evidence.fit import Fit, build_fitted_model, fit_jointly
from residual.evidence.fit import keep_physical_terms as physical_terms
from residual.evidence.priors import build_first_design, list_first_priors
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
    task, fitted = _best(build_first_design(logs, nominal), logs, nominal, wanted)
    if wanted:
        # As after a find: features that read the model's torque are made of the better.
        named = physical_terms(build_fitted_model(nominal, fitted))
        design = build_first_design(logs, nominal, named)
        task, fitted = _best(design, logs, nominal, wanted)
    # Without an adequacy: nobody asks this one what is left.
    found = SearchOutcome(
        logs, nominal, task, task.prior, fitted, fitted, (), (), adequacy=None
    )
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
    design: Design,
    logs: FitLogs,
    nominal: NominalModel,
    wanted: Sequence[tuple[Effect, Joints]],
) -> tuple[SearchTask, Fit]:
    """Return the fit under the prior that these logs are likeliest under."""
    # Columns do not depend on the prior: made anew for each of a score of priors, they
    # would fill the memory. Of each effect those of every shape that a search begins
    # with.
    grid = []
    for effect, joints in wanted:
        shapes = effect.shapes(logs.span, joints[0] if joints else 0)
        grid.append(design.add([PlacedEffect(effect, joints, s) for s in shapes]))
    runs = []
    for prior in list_first_priors(design, nominal):
        task = SearchTask(design, prior, Candidates((), {}), THRESHOLDS)
        runs.append((task, _fitted(task, grid)))
    counted = np.max([fitted.counted for _, fitted in runs], axis=0)
    worth = [
        fit_jointly(design, task.prior, fitted.members, counted, rounds=4).score
        for task, fitted in runs
    ]
    return runs[int(np.argmax(worth))]


def _fitted(task: SearchTask, grid: Sequence[Sequence[CandidateColumns]]) -> Fit:
    """Fit all of them, the shape of each searched as in a diagnosis."""
    current = task.start()
    for groups in grid:
        trials = [task.fit((*current.members, g), current) for g in groups]
        best = max(trials, key=lambda trial: trial.score)
        members = refine_last_shape(task, best.members, current)
        current = task.settle(task.fit(members, current))
    return current
