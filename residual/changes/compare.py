"""What changed since an earlier state of an arm: two epochs, one regression, one proof.

The first epoch's fit is the nominal model; what both epochs have is a nuisance, however
large; only what the second has beyond it is a finding (docs/changes.md).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from residual.changes.conclude import (
    HeldOutJudgement,
    analyze_residuals,
    build_change_verdict,
    change_clouds,
)
from residual.changes.models import EpochFit, build_augmented_model, fit_epoch
from residual.changes.rows import build_epoch_rows
from residual.changes.search import ChangeSearch, NamedChange, search_changes
from residual.changes.thresholds import ChangeThresholds
from residual.check.result import LogCheck
from residual.effects.base import EffectTrait
from residual.errors import format_joint_numbers
from residual.evidence.design import Design
from residual.evidence.fit import PossibleModel
from residual.model.compare import (
    ErrorSums,
    HeldOutLog,
    compute_error_rise,
    compute_model_errors,
    compute_moving_error,
    find_worse_joints,
    is_error_significant,
    prepare_held_out,
)
from residual.model.model import Model
from residual.model.nominal import FitLogs, NominalModel, prepare_fit_logs, start_model
from residual.model.rollout import compute_position_errors
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.splitting import find_session_start, pick_spread_pieces
from residual.signals.track import FilterSettings
from residual.verdict.edit_test import fit_all_parameters, run_edit_tests
from residual.verdict.result import PLAIN, STAGES, Diagnosis, tabulate_errors

Progress = Callable[[str, float], None]
# Of the error. Another motion asks more of the rest of a model than of a name, so that
# it must be much worse with it.
WORSE, BETTER = 1.25, 0.95


def compare_epochs(
    robot: Robot,
    first: Sequence[Recording],
    second: Sequence[Recording],
    held_out: Sequence[Recording],
    declared: Sequence[str] | Model | None,
    same_run: bool,
    tell: Progress,
    check: LogCheck | None = None,
    warnings: Sequence[str] = (),
) -> Diagnosis:
    """Say what changed between two epochs, and prove it on held-out logs.

    Args:
        held_out: Further logs of the second epoch.
        declared: Effects that the model has, None for the robot's own list; or the
            adopted model.
        same_run: Whether the held-out logs are a part of one of the second.
        check: Faults of the logs.
        warnings: Sentences on the logs that the verdict is to repeat.
    """
    rules = ChangeThresholds()
    tell("rows of both epochs", 0.0)
    logs, count, clocked = _prepare(robot, first, second, rules)
    # The model that the arm is said to have; its values are what the logs show.
    model = start_model(logs, declared)
    nominal = NominalModel(model, (None,) * len(model.terms))
    search = search_changes(build_epoch_rows(logs, count, nominal, rules), clocked)
    tell("what remains", 0.0)
    residuals = analyze_residuals(search)
    tell("proof", 0.0)
    before = _fit(robot, first, nominal)
    after = _fit(robot, second, nominal, before.model)
    proof = prepare_held_out(held_out, before.model)
    search, judgements, augmented = _judge_changes(
        search, proof, lambda own: build_augmented_model(own, nominal, before.model)
    )
    models = {"nominal": before.model, "identified": after.model}
    # Where nothing changed the contract of the verdict has both alike.
    models["augmented"] = augmented.model if search.changes else after.model
    errors, proofs = compute_model_errors(models, proof, logs.filters)
    verdict = build_change_verdict(
        search,
        residuals,
        judgements,
        error=tabulate_errors(
            {name: errors.get(name) for name in (*STAGES, PLAIN)},
            min(t.cutoff for t in search.both.logs.tracks),
            [r.id for r in held_out],
            same_run,
            find_worse_joints(models, proof),
            compute_position_errors({k: models[k] for k in STAGES[:3]}, held_out),
        ),
        edit=run_edit_tests(
            models,
            fit_all_parameters(Design(after.logs.tracks, nominal.model)),
            [c.place for c in search.changes],
            (),
            first,
        ),
        unproven=_unexplained(errors, search) if search.changes else None,
        augmented=augmented,
        epochs=(before, after),
        declared=nominal.names,
        check=check,
        warnings=warnings,
    )
    tell("proof", 1.0)
    return Diagnosis(
        verdict=verdict,
        models=models,
        proofs=proofs,
        clouds=change_clouds(search, residuals),
        notes=(*_notes(search), *augmented.notes),
        sentences=tuple(
            c.contrast.candidate.group.effect.sentence for c in search.changes
        ),
        adoptable=augmented.model,
    )


def _unexplained(errors: Mapping[str, ErrorSums], search: ChangeSearch) -> str | None:
    """Say so where what changed leaves far more on a joint than a refit.

    A name that is confirmed against the first epoch's model may still be the wrong
    one: then the model with it is worse than a refit without any name.
    """
    after, refit = (errors[k].per_joint("moving") for k in ("augmented", "identified"))
    over = np.flatnonzero(after > search.both.rules.max_error_ratio * refit)
    if not len(over):
        return None
    j = max(over, key=lambda j: after[j] / refit[j])
    return (
        "the named effects do not explain the change: on "
        f"{format_joint_numbers(over + 1)} the error is more than twice that of a "
        f"refit "
        f"(joint {j + 1}: {after[j]:.1f} against {refit[j]:.1f} %)"
    )


def _prepare(
    robot: Robot,
    first: Sequence[Recording],
    second: Sequence[Recording],
    rules: ChangeThresholds,
) -> tuple[FitLogs, int, bool]:
    """Logs of both epochs; the clock of the second begins with the first's."""
    sketches = [
        pick_spread_pieces(e, rules.long_seconds, rules.kept_seconds)
        for e in (first, second)
    ]
    starts = [find_session_start(epoch) for epoch in (first, second)]
    clocked = None not in starts
    if clocked:
        later = starts[0] - starts[1]
        sketches[1] = [replace(r, t=r.t + later) for r in sketches[1]]
    # The same name in both epochs is not the same log.
    named = [
        replace(r, id=f"{name}/{r.id}")
        for name, epoch in zip(("first", "second"), sketches, strict=True)
        for r in epoch
    ]
    clock = starts[0] if clocked else None
    logs = prepare_fit_logs(robot, named, clock, FilterSettings())
    return logs, len(sketches[0]), clocked


def _fit(
    robot: Robot,
    recordings: Sequence[Recording],
    nominal: NominalModel,
    like: Model | None = None,
) -> EpochFit:
    """Fit one epoch, beginning with the model of an earlier one."""
    clock = find_session_start(recordings)
    logs = prepare_fit_logs(
        robot, pick_spread_pieces(recordings), clock, FilterSettings()
    )
    return fit_epoch(logs, nominal, like)


def _judge_changes(
    search: ChangeSearch,
    proof: Sequence[HeldOutLog],
    model_of: Callable[[ChangeSearch], PossibleModel],
) -> tuple[ChangeSearch, Mapping[NamedChange, HeldOutJudgement], PossibleModel]:
    """Let the held-out logs judge each name; what they refute falls.

    Each name against the best that can be said without it.

    Returns:
        What stands, the judgement of each, and the augmented model.
    """
    refuted: list[NamedChange] = []
    while True:
        augmented = model_of(search)
        errors = compute_moving_error(augmented.model, proof)
        judgements = {}
        for change in search.changes:
            model_without = model_of(search.without([change])).model
            judgements[change] = _judge_change(
                change, errors, compute_moving_error(model_without, proof)
            )
        refuted_now = [c for c in search.changes if judgements[c].word == "refuted"]
        if augmented.contradicted and not refuted_now:
            # Not of a body what no body can be.
            bodies = [
                c
                for c in search.changes
                if EffectTrait.BODY in c.contrast.candidate.group.effect.traits
            ]
            search = replace(search.without(bodies), without_body=tuple(bodies))
            if bodies:
                continue
        if not refuted_now:
            return replace(search, refuted=tuple(refuted)), judgements, augmented
        worst = min(refuted_now, key=lambda c: judgements[c].gain)
        refuted.append(worst)
        search = search.without([worst])


def _judge_change(
    change: NamedChange, with_it: Array, without: Array
) -> HeldOutJudgement:
    """What held-out motion says of one name, over all joints that it acts on.

    Each joint's error counts as a share of what is left of it in any case.
    """
    on = list(change.contrast.candidate.pieces)
    least = np.minimum(with_it.sum(axis=0), without.sum(axis=0))[on]
    with_change, without_change = (
        x[:, on] / np.maximum(least, 1e-300) for x in (with_it, without)
    )
    with_change, without_change = with_change.sum(axis=1), without_change.sum(axis=1)
    ratio = float(np.sqrt(with_change.sum() / without_change.sum()))
    if compute_error_rise(with_change, without_change, WORSE):
        return HeldOutJudgement("refuted", 1 - ratio)
    word = (
        "confirmed"
        if ratio < BETTER and is_error_significant(without_change, with_change)
        else "neutral"
    )
    return HeldOutJudgement(word, 1 - ratio)


def _notes(search: ChangeSearch) -> tuple[str, ...]:
    noise, both = search.table.noise, search.both
    few = "; fewer than three baseline logs: differences between days are not known"
    seconds = both.rules.block_seconds * noise.blocks
    return (
        f"compared on {seconds:.0f} s of motion or more in "
        f"each epoch{few if both.first_logs < 3 else ''}",
        *(
            f"joint {j + 1}: baseline logs differ by {noise.unrest[j]:.1f} "
            "times the noise"
            for j in both.analyzable_joints
            if noise.unrest[j] > 1.3
        ),
    )
