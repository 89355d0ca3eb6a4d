"""The whole method on one screen: identify, doubt, name, add, prove.

residual -> undeclared effect -> augmented model -> error before and after on motion
that was not fitted (G2017 section 1.3 and 3, with a named effect in place of PLSR).
"""

from collections.abc import Sequence
from dataclasses import replace

from residual.diagnosis.angle_noise import freed, told
from residual.diagnosis.baseline import from_baseline
from residual.diagnosis.clouds import clouds
from residual.diagnosis.detectable import minimum_detectable
from residual.diagnosis.diagnose import Diagnosis, Progress, diagnose, without_refuted
from residual.diagnosis.findings import findings
from residual.diagnosis.gate import Tested
from residual.diagnosis.held_out import Verdicts, held_out_verdicts, unproven
from residual.diagnosis.leftover.leftover import depends_on
from residual.diagnosis.leftover.words import look_at_leftovers
from residual.diagnosis.log_checks import delayed_at_source, filtered_at_source
from residual.diagnosis.null_key import key_of
from residual.diagnosis.null_record import Null, fitting, said
from residual.diagnosis.result import Outcome
from residual.diagnosis.search import Rules
from residual.diagnosis.verdict import Case, complaint, write
from residual.errors import InputError
from residual.evidence.priors import ROUGH, priors
from residual.model.compare import compare, witnesses
from residual.model.fit_logs import ready, start_nominal
from residual.model.model import Model
from residual.model.nominal import declared_names
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.split import hold_out_end, session_clock
from residual.signals.track import Filters

NOISE = "withdrawn: noise of the angles makes all of it, or too much to believe it"


def close_the_loop(  # noqa: PLR0913  called from outside, by keyword
    robot: Robot,
    fit: Sequence[Recording],
    baseline: Sequence[Recording] = (),
    held_out: Sequence[Recording] = (),
    declared: Sequence[str] | None = None,
    progress: Progress | None = None,
    null: Null | Sequence[Null] | None = None,
) -> Outcome:
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

    Raises:
        InputError: If a log does not belong to the robot, an effect is unknown, or the
            null was made for other logs.
    """
    tell = progress or (lambda stage, share: None)
    names = declared_names(robot, declared)
    _check_joints(robot, [*fit, *baseline, *held_out])
    same_run = not held_out
    if same_run:
        fit, held_out = hold_out_end(fit)
    clock = session_clock([*fit, *held_out])
    filters = Filters()
    logs = ready(robot, fit, clock, filters)
    if baseline:
        nominal = from_baseline(robot, baseline, names, logs, tell)
    else:
        nominal = start_nominal(logs, names)
    null = fitting(null, key_of(logs, nominal))
    rules = Rules()
    if null:
        rules = replace(rules, threshold=null.threshold(rules.threshold))
    diagnosis = diagnose(logs, nominal, rules, tell)
    outcome = _prove(diagnosis, held_out, same_run, (fit, tell, null))
    tell("proof", 1.0)
    return outcome


def _prove(diagnosis: Diagnosis, held_out, same_run: bool, context) -> Outcome:
    fit, tell, null = context
    tell("proof", 0.0)
    proof = witnesses(held_out, diagnosis.nominal.model)
    judged, checks, noise = freed(diagnosis, held_out_verdicts(diagnosis, proof), fit)
    tested = [t for t, _ in judged.kept]
    models = _models(diagnosis, judged)
    diagnosis = without_refuted(diagnosis, judged.fit)
    left = look_at_leftovers(diagnosis, judged.fit, models["augmented"])
    if left.correction is not None:
        models["plsr"] = left.correction
    errors, proofs = compare(models, proof, diagnosis.logs.filters)
    found = findings(diagnosis, judged.fit, tested, checks)
    warned, noted = said(null, Rules().threshold)
    case = Case(
        diagnosis=diagnosis,
        found=found,
        gains={id(t): g for t, g in judged.kept},
        errors=errors,
        held_out=[r.id for r in held_out],
        same_run=same_run,
        minimum=_minimum(diagnosis, judged),
        depends_on=depends_on(left.joints),
        kinds=[one.kind for one in left.joints],
        p_value=null.p_value if null else None,
        warnings=[
            *_warnings(diagnosis, judged, same_run, noise),
            *warned,
            *unproven(diagnosis, errors["augmented"]),
            *left.said,
        ],
    )
    tell("proof", 0.8)
    return Outcome(
        verdict=write(case),
        sentences=tuple(f.effect.sentence for f in found),
        proofs=proofs,
        clouds=clouds(diagnosis, judged.fit, found),
        notes=(*_notes(diagnosis, fit, models), *told(checks, tested), *noted),
        left=tuple(one.cloud for one in left.joints),
    )


def _minimum(diagnosis: Diagnosis, judged: Verdicts) -> list[dict]:
    every = priors(diagnosis.task.design, diagnosis.nominal)
    return minimum_detectable(diagnosis.task, judged.fit, every)


def _models(diagnosis: Diagnosis, judged: Verdicts) -> dict[str, Model]:
    """The three models; identified and augmented differ by nothing but the effects."""
    augmented = diagnosis.model(judged.fit if judged.kept else diagnosis.plain)
    identified = augmented
    if judged.kept:
        identified = diagnosis.model(diagnosis.plain, like=augmented)
    nominal = diagnosis.nominal.model
    return {"nominal": nominal, "identified": identified, "augmented": augmented}


def _notes(diagnosis: Diagnosis, fit, models) -> tuple[str, ...]:
    logs = diagnosis.logs
    rows = diagnosis.task.design.rows
    every = sum(int(t.inner.sum()) for t in logs.tracks)
    notes = [
        f"identification filter {min(t.cutoff for t in logs.tracks):g} Hz, zero phase, "
        "on torque and regressor alike; "
        f"{logs.filters.edge:g} s dropped at both ends",
        "moving rows used per joint: "
        + ", ".join(f"{100 * r / max(every, 1):.0f} %" for r in rows),
    ]
    if logs.clock is None:
        notes.append("the order of the logs in time is not known: warm-up not tested")
    more = (filtered_at_source(fit), delayed_at_source(models["augmented"], logs))
    return (*notes, *(s for s in more if s))


def _warnings(
    diagnosis: Diagnosis, judged: Verdicts, same_run: bool, noise: Sequence[Tested]
) -> list[str]:
    out = [complaint(tested, NOISE) for tested in noise]
    if same_run:
        out.append(
            "no --holdout given: the last quarter of the longest log was held out; "
            "the proof is weak, since it is the same run"
        )
    scale = diagnosis.task.prior.scale
    if scale is not None and scale > ROUGH:
        out.append(
            f"the nominal model is off by about {100 * scale:.0f} %: too rough to "
            "blame a payload; give --baseline"
        )
    for tested, gain in judged.refuted:
        why = (
            "refuted by the held-out logs "
            f"(error there {100 * -gain:.1f} % higher with it), withdrawn"
        )
        question = tested.group.effect.if_refuted
        why += f"; {question}" if question else ""
        out.append(complaint(tested, why))
    for tested in judged.dropped:
        why = "withdrawn: it carries too little alone, now that others are refuted"
        out.append(complaint(tested, why))
    for tested in diagnosis.withdrawn:
        joint = tested.joint + 1
        out.append(
            complaint(
                tested,
                f"withdrawn: what joint {joint} shows resembles it but is not "
                "explained by it",
            )
        )
    return list(dict.fromkeys(out))  # two ripples of a joint make one sentence


def _check_joints(robot: Robot, recordings: Sequence[Recording]) -> None:
    for recording in recordings:
        if recording.dof != robot.dof:
            raise InputError(
                f"{recording.id} has {recording.dof} joints, {robot.name} has "
                f"{robot.dof}. Give the log's own robot with --robot."
            )
