"""Fit the true effects with their values free: the reference for a diagnosis.

Logs, model, prior and fit are those of the diagnosis, but effects and joints are given
instead of searched. A diagnosis that predicts as well has lost nothing by the search.
"""

from collections.abc import Sequence

import numpy as np

from residual.diagnosis.outcome import SearchOutcome
from residual.diagnosis.search import Candidates, Task, refine_shape
from residual.effects import registry
from residual.effects.base import Effect, Joints, PlacedEffect
from residual.errors import check_name
from residual.evidence.columns import Group
from residual.evidence.design import Design
from residual.evidence.fit import Fit, as_model, fit, physical
from residual.evidence.priors import first_design, priors
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import Errors, compare, prepare_held_out
from residual.model.model import Model
from residual.model.nominal import (
    Logs,
    Nominal,
    declared_names,
    prepare_logs,
    start_nominal,
)
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.splitting import session_clock
from residual.signals.track import Filters

Told = tuple[str, tuple[int, ...]]


def oracle(
    robot: Robot,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    effects: Sequence[Told],
) -> tuple[Model, Errors]:
    """Fit the effects that one is told of, and predict the held-out logs.

    Args:
        effects: Name and joints, from 1, of each missing effect.

    Raises:
        UnknownNameError: If there is no such effect.
    """
    clock = session_clock([*recordings, *held_out])
    logs = prepare_logs(robot, recordings, clock, Filters())
    nominal = start_nominal(logs, declared_names(robot, None))
    wanted = [pair for told in effects for pair in placed(*told, robot.dof)]
    task, fitted = _best(first_design(logs, nominal), logs, nominal, wanted)
    if wanted:
        # As after a find: features that read the model's torque are made of the better.
        named = physical(as_model(nominal, fitted))
        design = first_design(logs, nominal, named)
        task, fitted = _best(design, logs, nominal, wanted)
    # Without an adequacy: nobody asks this one what is left.
    found = SearchOutcome(
        logs, nominal, task, task.prior, fitted, fitted, (), (), adequacy=None
    )
    model = found.model(fitted).model
    proof = prepare_held_out(held_out, nominal.model)
    errors, _ = compare({"told": model}, proof, Filters())
    return model, errors["told"]


def placed(name: str, joints: Sequence[int], dof: int) -> list[tuple[Effect, Joints]]:
    """Return an effect with the joints (from 0) of each of its candidates.

    Args:
        joints: From 1.
    """
    effect = registry()[check_name(name, registry(), "effect")]
    on = tuple(sorted(j - 1 for j in joints))
    if effect.scope in ("global", "flange"):
        return [(effect, *effect.candidates(dof))]
    return [(effect, on)] if effect.scope == "pair" else [(effect, (j,)) for j in on]


def _best(
    design: Design,
    logs: Logs,
    nominal: Nominal,
    wanted: Sequence[tuple[Effect, Joints]],
) -> tuple[Task, Fit]:
    """Return the fit under the prior that these logs are likeliest under."""
    # Columns do not depend on the prior: made anew for each of a score of priors, they
    # would fill the memory. Of each effect those of every shape that a search begins
    # with.
    grid = []
    for effect, joints in wanted:
        shapes = effect.shapes(logs.span, joints[0] if joints else 0)
        grid.append(
            design.add([PlacedEffect(effect, joints, shape) for shape in shapes])
        )
    runs = []
    for prior in priors(design, nominal):
        task = Task(design, prior, Candidates((), {}), THRESHOLDS)
        runs.append((task, _fitted(task, grid)))
    counted = np.max([fitted.counted for _, fitted in runs], axis=0)
    worth = [
        fit(design, task.prior, fitted.members, counted, rounds=4).score
        for task, fitted in runs
    ]
    return runs[int(np.argmax(worth))]


def _fitted(task: Task, grid: Sequence[Sequence[Group]]) -> Fit:
    """Fit all of them, the shape of each searched as in a diagnosis."""
    current = task.start()
    for groups in grid:
        trials = [task.fit((*current.members, g), current) for g in groups]
        best = max(trials, key=lambda trial: trial.score)
        members = refine_shape(task, best.members, current)
        current = task.settle(task.fit(members, current))
    return current
