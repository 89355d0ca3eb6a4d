"""The method on one screen: search, assess, name, add, test.

residual -> undeclared effect -> augmented model -> error before and after on motion
that was not fitted (G2017 section 1.3 and 3, with a named effect in place of PLSR).
"""

from collections.abc import Sequence

from residual.check.result import LogCheck
from residual.diagnosis.changes import compare_epochs
from residual.diagnosis.errors_in_variables import check_angle_noise, describe_angle_noise
from residual.diagnosis.findings import merge_into_findings, residual_clouds, split_background
from residual.diagnosis.held_out import (
    build_three_models,
    fit_least_squares_model,
    prove,
    tabulate_held_out_errors,
)
from residual.diagnosis.open_question import build_open_question
from residual.diagnosis.outcome import Progress, search_effects
from residual.diagnosis.rivals import find_rival_sets
from residual.diagnosis.unexplained import analyze_unexplained
from residual.diagnosis.verdict import build_verdict, describe_signals, describe_used_part
from residual.errors import InputError
from residual.model.compare import compute_model_errors, prepare_held_out
from residual.model.model import Model
from residual.model.nominal import (
    GIVEN,
    FitLogs,
    NominalModel,
    add_joint_constants,
    choose_declared_effects,
    prepare_fit_logs,
    refuse_known_values_with_baseline,
    start_model,
)
from residual.recording import Recording
from residual.robot.robot import Robot, check_joint_count
from residual.signals.splitting import (
    find_session_start,
    pick_spread_pieces,
    split_off_last_quarter,
)
from residual.signals.track import FilterSettings
from residual.verdict.result import PLAIN, Diagnosis


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
    """Find the effects missing from a robot model, add them, and test on held-out motion.

    Args:
        baseline: Logs of an earlier state of the arm: the diagnosis then finds what
            has changed since.
        held_out: Logs for the test. Without any, the last quarter of the longest fit
            log is held out.
        declared: Effects that the model has; None for the robot's own list. Or the
            adopted model (`Diagnosis.adoptable`), with its logs as the baseline.
        ignore_baseline: Ignore the baseline, to find the open question of the fit logs
            alone.
        check: Faults of the logs, which may cause findings.
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

    # Effects missing from the nominal model, from the fit logs alone.
    pieces = pick_spread_pieces(fit)
    logs = prepare_fit_logs(robot, pieces, find_session_start(fit), FilterSettings())
    outcome = search_effects(logs, _build_nominal_model(logs, declared), tell)
    # The held-out logs are read once: a refuted effect leaves the model.
    tell("proof", 0.0)
    held = prepare_held_out(held_out, outcome.nominal.model)
    proof = prove(outcome, held)
    refuted, outcome = proof.refuted, proof.outcome
    models, bodies = build_three_models(outcome)
    remains = analyze_unexplained(outcome, outcome.fit, models["augmented"])
    noise = check_angle_noise(outcome, outcome.fit, pieces) if outcome.named else None
    found = merge_into_findings(outcome, outcome.fit, outcome.named, noise)
    named, background = split_background(found, robot.dof)
    suspects = (*refuted, *(m for m in outcome.suspected if m not in refuted))
    suspected = merge_into_findings(outcome, outcome.selection.fit, suspects)
    rivals = find_rival_sets(outcome.selection.search, outcome.fit)
    question = build_open_question(outcome, outcome.fit, named, rivals)
    augmented = models["augmented"]
    if remains.correction is not None:  # tables of the residual are a model too
        models["plsr"] = remains.correction
    # The error of every model on the held-out logs, next to plain least squares.
    filters = logs.filters
    errors, proofs = compute_model_errors(models, held, filters)
    plain = {PLAIN: fit_least_squares_model(logs)}
    reference, _ = compute_model_errors(plain, held, filters)
    errors = {k: e.without(logs.too_small) for k, e in (errors | reference).items()}
    verdict = build_verdict(
        proof,
        named,
        background,
        suspected,
        bodies,
        remains,
        question,
        rivals,
        errors,
        tabulate_held_out_errors(models, errors, held, held_out, logs, same_run),
        check,
        warnings,
    )
    tell("proof", 1.0)
    return Diagnosis(
        verdict=verdict,
        models=models,
        proofs=proofs,
        clouds=residual_clouds(outcome, outcome.fit, named),
        notes=(
            *describe_used_part(logs, fit),
            *describe_signals(outcome),
            *describe_angle_noise(noise, outcome.named),
            *bodies.notes,
        ),
        residual_clouds=tuple(one.cloud for one in remains.joints),
        sentences=tuple(f.effect.sentence for f in named),
        adoptable=augmented,
        question=question,
    )


def _build_nominal_model(logs: FitLogs, declared: Sequence[str] | Model | None) -> NominalModel:
    """Return the start of the search: the declared effects or an adopted model."""
    if isinstance(declared, Model):
        return NominalModel(start_model(logs, declared), (GIVEN,) * len(declared.terms))
    return add_joint_constants(logs, choose_declared_effects(logs.robot, declared))
