"""The whole method on one screen: identify, doubt, name, add, prove.

residual -> undeclared effect -> augmented model -> error before and after on motion
that was not fitted (G2017 section 1.3 and 3, with a named effect in place of PLSR).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from residual.diagnosis.baseline.drift import drifted
from residual.diagnosis.baseline.known import learnt, on_logs
from residual.diagnosis.baseline.learn import from_baseline
from residual.diagnosis.causes.edit.dense import dense_fit
from residual.diagnosis.causes.edit.edits import baseline_edits
from residual.diagnosis.conclude import Case, conclude
from residual.diagnosis.doubt.angle_noise import noise_notes
from residual.diagnosis.doubt.held_out import Verdicts, three_models, unproven
from residual.diagnosis.doubt.impossible import contradictions
from residual.diagnosis.doubt.standing import Standing, stand
from residual.diagnosis.drift import Drift
from residual.diagnosis.examine import (
    Examined,
    Progress,
    examine,
)
from residual.diagnosis.findings import Named, clouds
from residual.diagnosis.fold import folded
from residual.diagnosis.leftover.examine import Remains, examine_leftover
from residual.diagnosis.null_key import key_of
from residual.diagnosis.null_record import Null, choose_null, null_sentences
from residual.diagnosis.result import Diagnosis, Verdict
from residual.diagnosis.task import Rules
from residual.diagnosis.warnings import signal_notes, warnings
from residual.errors import InputError
from residual.evidence.fit import Fit
from residual.model.compare import Errors, compare, prepare_held_out
from residual.model.model import Model
from residual.model.nominal import (
    Logs,
    Nominal,
    declared_names,
    prepare_logs,
    start_nominal,
)
from residual.planning.gather import open_question
from residual.planning.promise import promised
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.split import hold_out_end, session_clock
from residual.signals.track import Filters

# The diagnosis, the fit of exactly what is named, and the findings.
Inside = Callable[[Examined, Fit, Sequence[Named]], None]


def close_the_loop(  # noqa: PLR0913  called from outside, by keyword
    robot: Robot,
    fit: Sequence[Recording],
    baseline: Sequence[Recording] = (),
    held_out: Sequence[Recording] = (),
    declared: Sequence[str] | None = None,
    progress: Progress | None = None,
    null: Null | Sequence[Null] | None = None,
    inside: Inside | None = None,
    known: Nominal | None = None,
) -> Diagnosis:
    """Find what a robot's model lacks, add it, and prove it on held-out motion.

    Args:
        robot: The arm as the user describes it.
        fit: Logs to diagnose.
        baseline: Logs of the arm as commissioned; they make the nominal model.
        held_out: Logs for the proof. Where there are none, the last quarter of the
            longest fit log is cut off and held out.
        declared: Effects that the model has; None for the robot's own list.
        progress: Told the stage and the share done.
        null: The calibrated null to go by, or several to choose a fitting one from.
        inside: Shown what the search knows, before it is let go.
        known: What an earlier diagnosis knew of this arm (`Diagnosis.known`): then that
            is the nominal model.

    Raises:
        InputError: If a log does not belong to the robot, an effect is unknown, the
            null was made for other logs, or several say what the nominal model is.
    """
    tell = progress or (lambda stage, share: None)
    if known is not None and (baseline or declared is not None):
        raise InputError(
            "A baseline, declared effects and an adopted model each say what the "
            "nominal model is. Give one of them."
        )
    _check_joints(robot, [*fit, *baseline, *held_out])
    same_run = not held_out
    if same_run:
        fit, held_out = hold_out_end(fit)
    logs = prepare_logs(robot, fit, session_clock([*fit, *held_out]), Filters())
    nominal = _nominal(logs, (known, baseline, declared), tell)
    null = choose_null(null, key_of(logs, nominal))
    rules = Rules()
    if null:
        rules = replace(rules, threshold=null.threshold(rules.threshold))
    examined = examine(logs, nominal, rules, tell)
    asked = _Asked(fit, baseline, held_out, same_run, null, tell, inside)
    found = _prove(examined, asked)
    tell("proof", 1.0)
    return found


def _nominal(logs: Logs, told: tuple, tell: Progress) -> Nominal:
    """The model to be doubted: adopted, of a baseline, or as the user gave it."""
    known, baseline, declared = told
    if known is not None:
        return on_logs(known, logs)
    names = declared_names(logs.robot, declared)
    if baseline:
        return from_baseline(logs.robot, baseline, names, logs, tell)
    return start_nominal(logs, names)


@dataclass(frozen=True, eq=False, slots=True)
class _Asked:
    """What the proof needs beside what was found."""

    fit: Sequence[Recording]
    baseline: Sequence[Recording]
    held_out: Sequence[Recording]
    same_run: bool
    null: Null | None
    tell: Progress
    inside: Inside | None


def _prove(examined: Examined, asked: _Asked) -> Diagnosis:
    """Let the held-out logs judge the names, and say what stands."""
    asked.tell("proof", 0.0)
    proof = prepare_held_out(asked.held_out, examined.nominal.model)
    standing = stand(examined, proof, asked.fit, asked.tell)
    examined, judged = standing.examined, standing.judged
    models, left = _models(examined, judged)
    listed, usual = folded(examined, standing.named)
    if asked.inside:
        asked.inside(examined, judged.fit, listed)
    drift, least = _drift(examined, judged.fit, asked)
    errors, proofs = compare(models, proof, examined.logs.filters)
    case = Case(
        examined=examined,
        named=listed,
        folded=usual,
        judged=judged,
        splits=standing.splits,
        errors=errors,
        held_out=[r.id for r in asked.held_out],
        same_run=asked.same_run,
        left=left.joints,
        warnings=_warned(standing, asked, errors["augmented"], left),
        contradictions=contradictions(examined, judged.fit, errors),
        drift=drift,
        least_drift=least,
        p_value=asked.null.p_value if asked.null else None,
    )
    verdict = replace(conclude(case), next_experiment=_hint(case))
    return Diagnosis(
        verdict=_with_edits(verdict, models, examined, asked),
        models=models,
        proofs=proofs,
        clouds=clouds(examined, judged.fit, listed),
        notes=_noted(standing, asked, models["augmented"]),
        left=tuple(one.cloud for one in left.joints),
        sentences=tuple(f.effect.sentence for f in listed),
        known=learnt(
            examined,
            judged.fit if judged.kept else examined.plain,
            models["augmented"],
        ),
    )


def _hint(case: Case) -> dict | None:
    """Say whether another experiment would decide what is left open."""
    found = promised(open_question(case.examined, case.judged.fit, case.named))
    return None if found is None else found.document()


def _with_edits(
    verdict: Verdict, models: dict, examined: Examined, asked: _Asked
) -> Verdict:
    """Take the names out again where logs of before can tell whether that is right."""
    if not asked.baseline:
        return verdict
    dense = dense_fit(examined.task.design)
    found = verdict.effects, verdict.background
    return replace(verdict, edit=baseline_edits(models, dense, found, asked.baseline))


def _warned(
    standing: Standing, asked: _Asked, augmented: Errors, left: Remains
) -> list[str]:
    """Sentences that qualify the answer."""
    by_chance, _ = null_sentences(asked.null, Rules().threshold)
    return [
        *warnings(standing.examined, standing.withdrawn, asked.same_run),
        *by_chance,
        *unproven(standing.examined, augmented),
        *left.sentences,
    ]


def _noted(standing: Standing, asked: _Asked, augmented: Model) -> tuple[str, ...]:
    """What was understood of the signals."""
    _, by_rule = null_sentences(asked.null, Rules().threshold)
    return (
        *signal_notes(standing.examined, asked.fit, augmented),
        *noise_notes(standing.checks, [t for t, _ in standing.judged.kept]),
        *by_rule,
    )


def _models(examined: Examined, judged: Verdicts) -> tuple[dict, Remains]:
    """The models to compare, tables for the rest among them; and what is left."""
    models = three_models(examined, judged)
    left = examine_leftover(examined, judged.fit, models["augmented"])
    if left.correction is not None:
        models["plsr"] = left.correction
    return models, left


def _drift(
    examined: Examined, fitted: Fit, asked: _Asked
) -> tuple[Drift | None, float | None]:
    """Only against a baseline, or a model that was adopted, is friction a change."""
    if examined.nominal.covariance is None:
        return None, None
    shared = session_clock([*asked.baseline, *asked.fit]) is not None
    clock = "recording time" if shared else "order"
    return drifted(examined.task.design, examined.nominal, fitted, clock)


def _check_joints(robot: Robot, recordings: Sequence[Recording]) -> None:
    for recording in recordings:
        if recording.dof != robot.dof:
            raise InputError(
                f"{recording.id} has {recording.dof} joints, {robot.name} has "
                f"{robot.dof}. Give the log's own robot with --robot."
            )
