"""The method on one screen: search, doubt, name, add, prove.

residual -> undeclared effect -> augmented model -> error before and after on motion
that was not fitted (G2017 section 1.3 and 3, with a named effect in place of PLSR).
"""

from collections.abc import Sequence

from residual.changes.compare import compare_epochs
from residual.check.result import LogCheck
from residual.diagnosis.constants import add_joint_constants
from residual.diagnosis.doubts import split_background, withdraw_doubtful_names
from residual.diagnosis.errors_in_variables import describe_angle_noise
from residual.diagnosis.findings import residual_clouds
from residual.diagnosis.held_out import build_three_models, fit_least_squares_model
from residual.diagnosis.open_question import build_open_question
from residual.diagnosis.outcome import Progress, search_effects
from residual.diagnosis.unexplained import analyze_unexplained
from residual.diagnosis.verdict import build_verdict, describe_signals
from residual.errors import InputError
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import (
    compute_model_errors,
    find_worse_joints,
    prepare_held_out,
)
from residual.model.model import Model
from residual.model.nominal import (
    GIVEN,
    FitLogs,
    NominalModel,
    choose_declared_effects,
    prepare_fit_logs,
    refuse_known_values_with_baseline,
    start_model,
)
from residual.model.rollout import compute_position_errors
from residual.recording import Recording
from residual.robot.robot import Robot, check_joint_count
from residual.signals.splitting import find_session_start, split_off_last_quarter
from residual.signals.track import FilterSettings
from residual.verdict.result import PLAIN, STAGES, Diagnosis, tabulate_errors


def diagnose(
    robot: Robot,
    fit: Sequence[Recording],
    baseline: Sequence[Recording] = (),
    held_out: Sequence[Recording] = (),
    declared: Sequence[str] | Model | None = None,
    progress: Progress | None = None,
    ignore_baseline: bool = False,
    check: LogCheck | None = None,
    warnings: Sequence[str] = (),
) -> Diagnosis:
    """Find what a robot's model lacks, add it, and prove it on held-out motion.

    Args:
        baseline: Logs of an earlier state of the arm: the diagnosis then finds what
            has changed since.
        held_out: Logs for the proof. Without any, the last quarter of the longest fit
            log is cut off and held out.
        declared: Effects that the model has; None for the robot's own list. Or the
            adopted model (`Diagnosis.adoptable`), with its logs as the baseline.
        ignore_baseline: Ignore the baseline, for what the fit logs by themselves leave
            open.
        check: Faults of the logs: what is named may be due to them.
        warnings: Sentences on the logs that the verdict repeats first.

    Raises:
        InputError: If a log does not belong to the robot, an effect is unknown, or an
            adopted model comes without its logs.
    """
    tell = progress or (lambda stage, share: None)
    check_joint_count(robot, [*fit, *baseline, *held_out])
    same_run = not held_out
    if same_run:
        fit, held_out = split_off_last_quarter(fit)
    if isinstance(declared, Model) and not baseline:
        raise InputError(
            "The adopted model has no logs, so changes since then cannot be found: "
            "give its logs as the baseline."
        )
    if baseline and not ignore_baseline:
        refuse_known_values_with_baseline(robot)
        epochs = robot, baseline, fit, held_out
        return compare_epochs(*epochs, declared, same_run, tell, check, warnings)

    # The nominal model, and a search for what it lacks.
    logs = prepare_fit_logs(
        robot, fit, find_session_start([*fit, *held_out]), FilterSettings()
    )
    nominal = _build_nominal_model(logs, declared)
    outcome = search_effects(logs, nominal, THRESHOLDS, tell)
    # Every name is doubted, on held-out motion too; what stands is in the models.
    tell("proof", 0.0)
    proof = prepare_held_out(held_out, outcome.nominal.model)
    standing = withdraw_doubtful_names(outcome, proof, fit, tell)
    outcome, validation = standing.outcome, standing.validation
    models, bodies = build_three_models(outcome, validation)
    augmented = models["augmented"]
    remains = analyze_unexplained(outcome, validation.fit, augmented)
    named, background = split_background(standing.named, outcome.logs.robot.dof)
    question = build_open_question(outcome, validation.fit, named)
    if remains.correction is not None:  # tables for the rest are a model too
        models["plsr"] = remains.correction
    # The error of every model on the held-out logs, beside plain least squares.
    filters = outcome.logs.filters
    errors, proofs = compute_model_errors(models, proof, filters)
    reference, _ = compute_model_errors(
        {PLAIN: fit_least_squares_model(logs)}, proof, filters
    )
    small = outcome.logs.too_small
    errors = {name: e.without(small) for name, e in (errors | reference).items()}
    verdict = build_verdict(
        standing,
        named,
        background,
        bodies,
        remains,
        question,
        errors,
        tabulate_errors(
            {name: errors.get(name) for name in (*STAGES, PLAIN)},
            min(t.cutoff for t in outcome.logs.tracks),
            [r.id for r in held_out],
            same_run,
            find_worse_joints(models, proof),
            compute_position_errors({k: models[k] for k in STAGES[:3]}, held_out),
        ),
        check,
        warnings,
    )
    tell("proof", 1.0)
    return Diagnosis(
        verdict=verdict,
        models=models,
        proofs=proofs,
        clouds=residual_clouds(outcome, validation.fit, named),
        notes=(
            *describe_signals(outcome),
            *describe_angle_noise(standing.checks, [t for t, _ in validation.kept]),
            *bodies.notes,
        ),
        residual_clouds=tuple(one.cloud for one in remains.joints),
        sentences=tuple(f.effect.sentence for f in named),
        adoptable=augmented,
        question=question,
    )


def _build_nominal_model(
    logs: FitLogs, declared: Sequence[str] | Model | None
) -> NominalModel:
    """Return what the search starts from: the declared effects or an adopted model."""
    if isinstance(declared, Model):
        return NominalModel(start_model(logs, declared), (GIVEN,) * len(declared.terms))
    return add_joint_constants(logs, choose_declared_effects(logs.robot, declared))
