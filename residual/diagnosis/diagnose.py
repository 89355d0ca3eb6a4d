"""The whole method on one screen: identify, doubt, name, add, prove.

residual -> undeclared effect -> augmented model -> error before and after on motion
that was not fitted (G2017 section 1.3 and 3, with a named effect in place of PLSR).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from residual.changes.compare import Asked, compared
from residual.check.result import LogCheck
from residual.diagnosis.constants import nominal_with_constants
from residual.diagnosis.doubts import Standing, stand
from residual.diagnosis.errors_in_variables import noise_notes
from residual.diagnosis.findings import clouds, folded
from residual.diagnosis.held_out import three_models, unproven
from residual.diagnosis.open_question import open_question, places_of
from residual.diagnosis.outcome import Progress, examine
from residual.diagnosis.reference import plain_fit
from residual.diagnosis.unexplained import Remains, examine_leftover
from residual.diagnosis.verdict import (
    Case,
    conclude,
    contradictions,
    signal_notes,
    warnings,
)
from residual.errors import InputError
from residual.evidence.rules import RULES
from residual.model.compare import (
    Errors,
    HeldOutLog,
    compare,
    prepare_held_out,
    worse_joints,
)
from residual.model.model import Model
from residual.model.nominal import (
    GIVEN,
    Nominal,
    begin,
    declared_names,
    prepare_logs,
)
from residual.planning.promise import promised, settled_by
from residual.recording import Recording
from residual.robot.robot import Robot, check_joints
from residual.signals.splitting import hold_out_end, session_clock
from residual.signals.track import Filters
from residual.verdict.result import PLAIN, Diagnosis, ErrorTables


def diagnose(
    robot: Robot,
    fit: Sequence[Recording],
    baseline: Sequence[Recording] = (),
    held_out: Sequence[Recording] = (),
    declared: Sequence[str] | Model | None = None,
    progress: Progress | None = None,
    alone: bool = False,
) -> Diagnosis:
    """Find what a robot's model lacks, add it, and prove it on held-out motion.

    Args:
        baseline: Logs of the arm as it was: then what has changed since is found.
        held_out: Logs for the proof. Where there are none, the last quarter of the
            longest fit log is cut off and held out.
        declared: Effects that the model has; None for the robot's own list. Or the
            model that was adopted (`Diagnosis.known`), with the logs behind it as the
            baseline.
        alone: Look at the fit logs by themselves although there is a baseline, for
            what they leave open.

    Raises:
        InputError: If a log does not belong to the robot, an effect is unknown, or an
            adopted model comes without its logs.
    """
    tell = progress or (lambda stage, share: None)
    check_joints(robot, [*fit, *baseline, *held_out])
    same_run = not held_out
    if same_run:
        fit, held_out = hold_out_end(fit)
    if isinstance(declared, Model) and not baseline:
        raise InputError(
            "An adopted model comes without the logs behind it, so what changed since "
            "cannot be told. Give them as the baseline."
        )
    wanted = _Wanted(fit, held_out, same_run, tell)
    if alone or not baseline:
        return _alone(robot, declared, wanted)
    if robot.known:
        raise InputError(
            f"Known values ({', '.join(robot.known)}) are of one state of the arm, and "
            "a baseline compares two. Leave out either."
        )
    return compared(Asked(robot, baseline, fit, held_out, declared, same_run), tell)


def _alone(
    robot: Robot, start: Sequence[str] | Model | None, asked: "_Wanted"
) -> Diagnosis:
    """Diagnose logs by themselves: what they show and the model lacks."""
    clock = session_clock([*asked.fit, *asked.held_out])
    logs = prepare_logs(robot, asked.fit, clock, Filters())
    if isinstance(start, Model):
        nominal = Nominal(begin(logs, start), (GIVEN,) * len(start.terms))
    else:
        nominal = nominal_with_constants(logs, declared_names(logs.robot, start))
    examined = examine(logs, nominal, RULES, asked.tell)
    asked.tell("proof", 0.0)
    proof = prepare_held_out(asked.held_out, examined.nominal.model)
    standing = stand(examined, proof, asked.fit, asked.tell)
    found = _concluded(standing, proof, plain_fit(logs), asked)
    asked.tell("proof", 1.0)
    return found


@dataclass(frozen=True, eq=False, slots=True)
class _Wanted:
    """What the proof needs beside what was found."""

    fit: Sequence[Recording]
    held_out: Sequence[Recording]
    same_run: bool
    tell: Progress


def _concluded(
    standing: Standing,
    proof: Sequence[HeldOutLog],
    plain: Model,
    asked: _Wanted,
) -> Diagnosis:
    """Say what stands, with the error of every model on the held-out logs."""
    examined, judged = standing.examined, standing.judged
    models, bodies = three_models(examined, judged)
    left = examine_leftover(examined, judged.fit, models["augmented"])
    if left.correction is not None:  # tables for the rest are a model too
        models["plsr"] = left.correction
    listed, usual = folded(standing.named, examined.logs.robot.dof)
    errors, proofs = compare(models, proof, examined.logs.filters)
    reference, _ = compare({PLAIN: plain}, proof, examined.logs.filters)
    small = examined.logs.too_small
    errors = {name: e.without(small) for name, e in (errors | reference).items()}
    warned, noted = _said(standing, asked, models, errors, left)
    case = Case(
        examined=examined,
        named=listed,
        folded=usual,
        judged=judged,
        splits=standing.splits,
        suspected=standing.suspected,
        gains=standing.gains,
        errors=errors,
        worse=worse_joints(models, proof),
        held_out=[r.id for r in asked.held_out],
        same_run=asked.same_run,
        left=left.joints,
        warnings=warned,
        bodies=bodies,
        contradictions=(
            *contradictions(examined, judged.fit, errors),
            *bodies.doubts,
        ),
    )
    question = open_question(examined, judged.fit, listed)
    verdict, places = conclude(case), places_of(judged.fit.members)
    verdict = replace(
        verdict,
        next_experiment=promised(question),
        alternatives=settled_by(question, places, verdict.alternatives),
    )
    return Diagnosis(
        verdict=verdict,
        models=models,
        proofs=proofs,
        clouds=clouds(examined, judged.fit, listed),
        notes=(*noted, *bodies.notes),
        left=tuple(one.cloud for one in left.joints),
        sentences=tuple(f.effect.sentence for f in listed),
        known=models["augmented"],
        question=question,
    )


def _said(
    standing: Standing,
    asked: _Wanted,
    models: Mapping[str, Model],
    errors: Mapping[str, Errors],
    left: Remains,
) -> tuple[list[str], list[str]]:
    """Sentences that qualify the answer, and what was understood of the signals."""
    warned = [
        *warnings(standing.examined, standing.withdrawn, asked.same_run),
        *unproven(standing.examined, errors["augmented"]),
        *left.sentences,
    ]
    noted = [
        *signal_notes(standing.examined, asked.fit, models["augmented"]),
        *noise_notes(standing.checks, [t for t, _ in standing.judged.kept]),
    ]
    return warned, noted


_FOUND = ("augmented", "plsr")  # models that have what was named, or what remained


def with_check(found: Diagnosis, report: LogCheck) -> Diagnosis:
    """Return a diagnosis with the check of its logs.

    With a certain fault nothing is named, and nothing is said to be missing or not:
    what was found may be the fault.
    """
    warnings = (*report.sentences, *found.warnings)
    verdict = replace(found.verdict, log_check=report, warnings=warnings)
    if not report.certain:
        return replace(found, verdict=verdict)
    models = {k: m for k, m in found.models.items() if k not in _FOUND}
    if "identified" in models:
        models["augmented"] = models["identified"]
    unnamed = replace(
        verdict,
        verdict="unknown",
        effects=(),
        suspected=(),
        minimum_detectable=(),
        next_experiment=None,
        edit=None,
        error=_errors(verdict.error),
    )
    return replace(
        found,
        verdict=unnamed,
        models=models,
        proofs=tuple(replace(p, tau_hat=_refit(p.tau_hat)) for p in found.proofs),
        clouds=(),
        sentences=(),
    )


def _errors(error: ErrorTables) -> ErrorTables:
    overall = ("overall", "overall_filtered", "overall_moving")
    tables = {
        name: _refit(getattr(error, name)) | {"plsr": None}
        for name in ("held_out", "filtered", "moving", *overall)
    }
    return replace(error, worse=(), **tables)


def _refit(by_model: Mapping) -> dict:
    """Return what is known of every model, where nothing was found."""
    kept = {name: value for name, value in by_model.items() if name not in _FOUND}
    return kept | {"augmented": by_model["identified"]}
