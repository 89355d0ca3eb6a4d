"""Changes since an earlier state of an arm: two epochs, one search, one held-out test.

The first epoch's fit is the nominal model; effects of both epochs are shared, however
large; only additional effects of the second are findings (docs/changes.md).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from residual.check.result import LogCheck
from residual.diagnosis.change_verdict import build_change_verdict
from residual.diagnosis.epoch_outcome import conclude_epochs, fit_epoch
from residual.diagnosis.epochs import Epochs, search_epochs
from residual.diagnosis.findings import merge_into_findings, residual_clouds
from residual.diagnosis.held_out import prove, tabulate_held_out_errors
from residual.diagnosis.outcome import Progress
from residual.diagnosis.rivals import find_rival_sets
from residual.diagnosis.unexplained import analyze_joint_remainders
from residual.diagnosis.verdict import describe_used_part
from residual.errors import format_joint_numbers
from residual.evidence.design import Design
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import ErrorSums, compute_model_errors, prepare_held_out
from residual.model.model import Model
from residual.model.nominal import FitLogs, NominalModel, prepare_fit_logs, start_model
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.splitting import find_session_start, group_pieces_by_log, pick_spread_pieces
from residual.signals.track import FilterSettings
from residual.verdict.diagnosis import fit_all_parameters, run_edit_tests
from residual.verdict.result import Diagnosis


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
    """Find the changes between two epochs, and test them on held-out logs.

    Args:
        held_out: Further logs of the second epoch.
        declared: Effects that the model has, None for the robot's own list; or the
            adopted model.
        same_run: Whether the held-out logs are part of a log of the second epoch.
        check: Faults of the logs.
        warnings: Sentences on the logs that the verdict repeats.
    """
    tell("search", 0.0)
    logs, count = _prepare(robot, first, second)
    # The declared model, with values from the logs.
    model = start_model(logs, declared)
    nominal = NominalModel(model, (None,) * len(model.terms))
    epochs, run = search_epochs(logs, count, nominal, lambda x: tell("search", x))
    before = fit_epoch(robot, first, nominal)
    after = fit_epoch(robot, second, nominal, before.model)
    outcome = conclude_epochs(epochs, run, before.model)
    tell("proof", 0.0)
    held = prepare_held_out(held_out, before.model)
    proof = prove(outcome, held)
    outcome = proof.outcome
    remains = analyze_joint_remainders(outcome.design, logs.tracks, outcome.fit, outcome.adequacy)
    found = merge_into_findings(outcome, outcome.fit, outcome.named)
    refuted = proof.refuted
    suspects = (*refuted, *(m for m in outcome.suspected if m not in refuted))
    suspected = merge_into_findings(outcome, outcome.selection.fit, suspects)
    augmented = outcome.model(outcome.fit)
    models = {"nominal": before.model, "identified": after.model}
    # Without a change, both models of the verdict are equal by contract.
    models["augmented"] = augmented.model if found else after.model
    errors, proofs = compute_model_errors(models, held, logs.filters)
    verdict = build_change_verdict(
        proof,
        found,
        suspected,
        augmented,
        remains,
        find_rival_sets(outcome.selection.search, outcome.fit),
        (before, after),
        tabulate_held_out_errors(models, errors, held, held_out, logs, same_run),
        check,
        (*warnings, *(check.sentences if check else ())),
        _unexplained_sentences(errors) if found else (),
    )
    dense = fit_all_parameters(Design(after.logs.tracks, nominal.model))
    edit = run_edit_tests(models, dense, verdict.effects, (), first)
    tell("proof", 1.0)
    clouds = residual_clouds(outcome, outcome.fit, found)
    return Diagnosis(
        verdict=replace(verdict, edit=edit),
        models=models,
        proofs=proofs,
        clouds=tuple(replace(c, log=_without_epoch(c.log)) for c in clouds),
        notes=(*describe_used_part(logs, (*first, *second)), *_notes(epochs), *augmented.notes),
        sentences=tuple(f.effect.sentence for f in found),
        adoptable=augmented.model,
    )


def _without_epoch(log: Array) -> Array:
    return np.array([name.split("/", 1)[-1] for name in log.tolist()])


def _unexplained_sentences(errors: Mapping[str, ErrorSums]) -> tuple[str, ...]:
    """Warn where the changes leave a far larger error on a joint than a refit.

    A confirmed change may still be the wrong one: then the model with it is worse than
    a refit without it.
    """
    after, refit = (errors[k].per_joint("moving") for k in ("augmented", "identified"))
    over = np.flatnonzero(after > THRESHOLDS.unlike_refit_ratio * refit)
    if not len(over):
        return ()
    j = max(over, key=lambda j: after[j] / refit[j])
    return (
        "the named effects do not explain the change: on "
        f"{format_joint_numbers(over + 1)} the error is more than twice that of a "
        f"refit (joint {j + 1}: {after[j]:.1f} against {refit[j]:.1f} %)",
    )


def _prepare(
    robot: Robot, first: Sequence[Recording], second: Sequence[Recording]
) -> tuple[FitLogs, int]:
    """Logs of both epochs; the clock of the second begins with the first's."""
    lengths = THRESHOLDS.long_epoch, THRESHOLDS.kept_epoch
    sketches = [pick_spread_pieces(e, *lengths) for e in (first, second)]
    starts = [find_session_start(epoch) for epoch in (first, second)]
    clock = None if None in starts else starts[0]
    if clock is not None:
        later = clock - starts[1]
        sketches[1] = [replace(r, t=r.t + later) for r in sketches[1]]
    # Logs of the same name in both epochs are different logs.
    named = [
        replace(r, id=f"{name}/{r.id}")
        for name, epoch in zip(("first", "second"), sketches, strict=True)
        for r in epoch
    ]
    return prepare_fit_logs(robot, named, clock, FilterSettings()), len(sketches[0])


def _notes(epochs: Epochs) -> tuple[str, ...]:
    ids = [t.id for t in epochs.logs.tracks[: epochs.first]]
    few = "; fewer than three baseline logs: differences between days are not known"
    return (
        f"compared on {epochs.design.folds} blocks of both epochs"
        f"{few if len(group_pieces_by_log(ids)) < THRESHOLDS.few_logs else ''}",
        *(
            f"joint {j + 1}: baseline logs differ by {unrest:.1f} times the noise"
            for j, unrest in enumerate(epochs.design.unrest)
            if unrest > 1.3
        ),
    )
