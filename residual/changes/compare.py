"""What changed since an earlier state of an arm: two epochs, one regression, one proof.

The first epoch's fit is the nominal model; what both epochs have is a nuisance, however
large; only what the second has beyond it is a finding (docs/changes.md).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.changes.conclude import Judged, clouds, conclude
from residual.changes.models import Epoch, augmented, fit_epoch
from residual.changes.rows import both_epochs
from residual.changes.rules import Rules
from residual.changes.search import Change, Found, find
from residual.changes.unexplained import unnamed
from residual.effects.base import Trait
from residual.errors import joints_listed
from residual.evidence.design import Design
from residual.evidence.embodied import Embodied
from residual.model.compare import (
    Errors,
    HeldOutLog,
    compare,
    is_sure,
    moving_error,
    prepare_held_out,
    rise,
    worse_joints,
)
from residual.model.model import Model
from residual.model.nominal import Logs, Nominal, begin, prepare_logs
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.splitting import session_clock, sketch_of
from residual.signals.track import Filters
from residual.verdict.edit import baseline_edits, dense_fit
from residual.verdict.result import (
    PLAIN,
    STAGES,
    STILL,
    Diagnosis,
    Verdict,
    as_embodied,
    error_tables,
)

Progress = Callable[[str, float], None]
# Of the error. Another motion asks more of the rest of a model than of a name, so that
# it must be much worse with it.
WORSE, BETTER = 1.25, 0.95


@dataclass(frozen=True, eq=False, slots=True)
class Asked:
    """What is compared."""

    robot: Robot  # the arm as the user describes it
    # Logs of both epochs.
    first: Sequence[Recording]
    second: Sequence[Recording]
    held_out: Sequence[Recording]  # further logs of the second epoch, for the proof
    # Effects that the model has, None for the robot's own list; or the model that was
    # adopted.
    declared: Sequence[str] | Model | None
    same_run: bool  # whether the held-out logs are a part of one of the second


def compared(asked: Asked, tell: Progress) -> Diagnosis:
    """Say what changed between two epochs, and prove it on held-out logs."""
    rules = Rules()
    tell("rows of both epochs", 0.0)
    logs, count, clocked = prepared(asked, rules)
    nominal = described(logs, asked.declared)
    found = find(both_epochs(logs, count, nominal, rules), clocked)
    tell("what remains", 0.0)
    rest = unnamed(found)
    tell("proof", 0.0)
    before = epoch_of(asked, asked.first, nominal)
    after = epoch_of(asked, asked.second, nominal, before.model)
    proof = prepare_held_out(asked.held_out, before.model)
    found, judged, now = _judged(
        found, proof, lambda own: augmented(own, nominal, before.model)
    )
    models = {"nominal": before.model, "identified": after.model}
    # Where nothing changed the contract of the verdict has both alike.
    models["augmented"] = now.model if found.changes else after.model
    errors, proofs = compare(models, proof, logs.filters)
    over = _unexplained(errors, found) if found.changes else []
    verdict = conclude(
        found,
        rest,
        judged,
        error_tables(
            {name: errors.get(name) for name in (*STAGES, PLAIN)},
            min(t.cutoff for t in found.both.logs.tracks),
            [r.id for r in asked.held_out],
            asked.same_run,
            worse_joints(models, proof),
        ),
        epochs=(before, after),
        declared=nominal.names,
    )
    verdict = _with_doubt(verdict, over)
    edit = baseline_edits(
        models,
        dense_fit(Design(after.logs.tracks, nominal.model)),
        (verdict.effects, ()),
        asked.first,
    )
    tell("proof", 1.0)
    return Diagnosis(
        verdict=_doubted(replace(verdict, edit=edit), now, after),
        models=models,
        proofs=proofs,
        clouds=clouds(found, rest),
        notes=(*_notes(found), *now.notes),
        sentences=tuple(
            c.contrast.candidate.group.effect.sentence for c in found.changes
        ),
        known=now.model,
    )


def _unexplained(errors: Mapping[str, Errors], found: Found) -> list[tuple]:
    """Joints (from 1) on which what changed leaves far more than a refit; both errors.

    A name that is confirmed against the first epoch's model may still be the wrong
    one: then the model with it is worse than a refit without any name.
    """
    after, refit = (errors[k].per_joint("moving") for k in ("augmented", "identified"))
    far = after > found.both.rules.explained * refit
    return [(j + 1, after[j], refit[j]) for j in np.flatnonzero(far)]


def _with_doubt(verdict: Verdict, over: Sequence[tuple]) -> Verdict:
    """The verdict, in which no change is confirmed that does not explain the logs."""
    if not over:
        return verdict
    effects = tuple(
        replace(f, evidence=replace(f.evidence, held_out="neutral"))
        for f in verdict.effects
    )
    worst, after, refit = max(over, key=lambda entry: entry[1] / entry[2])
    said = (
        f"what is named does not explain the change: on "
        f"{joints_listed([j for j, *_ in over])} the model with it leaves more than "
        f"twice the error of a refit (joint {worst}: {after:.1f} against {refit:.1f} %)"
    )
    return replace(verdict, effects=effects, warnings=(*verdict.warnings, said))


def _doubted(verdict: Verdict, made: Embodied, after: Epoch) -> Verdict:
    """The verdict with what no body can be, or that nothing moved: never "none"."""
    doubts = made.doubts
    if not any(t.moving.any() for t in after.logs.tracks):
        doubts = (STILL,)
    out = replace(
        verdict,
        effects=tuple(as_embodied(f, made) for f in verdict.effects),
        bodies=made.moved,
        contradictions=doubts,
    )
    unsure = doubts and verdict.verdict == "none"
    return replace(out, verdict="unknown") if unsure else out


def prepared(asked: Asked, rules: Rules) -> tuple[Logs, int, bool]:
    """Logs of both epochs on one clock that begins anew with the second."""
    first = sketch_of(asked.first, rules.most_seconds, rules.seconds)
    second = sketch_of(asked.second, rules.most_seconds, rules.seconds)
    starts = [session_clock(own) for own in (asked.first, asked.second)]
    clocked = None not in starts
    if clocked:
        later = starts[0] - starts[1]
        second = [replace(r, t=r.t + later) for r in second]
    # The same name in both epochs is not the same log.
    named = [
        *(replace(r, id=f"first/{r.id}") for r in first),
        *(replace(r, id=f"second/{r.id}") for r in second),
    ]
    clock = starts[0] if clocked else None
    return prepare_logs(asked.robot, named, clock, Filters()), len(first), clocked


def described(logs: Logs, declared: Sequence[str] | Model | None) -> Nominal:
    """The model that the arm is said to have; its values are what the logs show."""
    model = begin(logs, declared)
    return Nominal(model, (None,) * len(model.terms))


def epoch_of(
    asked: Asked,
    recordings: Sequence[Recording],
    nominal: Nominal,
    like: Model | None = None,
) -> Epoch:
    """One epoch's own fit, begun with an earlier one's where there is."""
    logs = prepare_logs(
        asked.robot, sketch_of(recordings), session_clock(recordings), Filters()
    )
    return fit_epoch(logs, nominal, like)


def _judged(
    found: Found, proof: Sequence[HeldOutLog], model_of: Callable[[Found], Embodied]
) -> tuple[Found, Mapping[Change, Judged], Embodied]:
    """Let the held-out logs judge each name; what they refute falls.

    Each name against the best that can be said without it.

    Returns:
        What stands, the judgement of each, and the augmented model.
    """
    refuted: list[Change] = []
    while True:
        made = model_of(found)
        whole = moving_error(made.model, proof)
        judged = {}
        for change in found.changes:
            less = replace(
                found, changes=tuple(c for c in found.changes if c is not change)
            )
            judged[change] = _judgement(
                change, whole, moving_error(model_of(less).model, proof)
            )
        worst = [c for c in found.changes if judged[c].word == "refuted"]
        if made.contradicted and not worst:
            # Not of a body what no body can be.
            of_bodies = [c for c in found.changes if _is_body(c)]
            left = tuple(c for c in found.changes if c not in of_bodies)
            found = replace(found, changes=left, bodiless=tuple(of_bodies))
            if of_bodies:
                continue
        if not worst:
            return replace(found, refuted=tuple(refuted)), judged, made
        gone = min(worst, key=lambda c: judged[c].gain)
        refuted.append(gone)
        found = replace(found, changes=tuple(c for c in found.changes if c is not gone))


def _is_body(change: Change) -> bool:
    return Trait.BODY in change.contrast.candidate.group.effect.traits


def _judgement(change: Change, with_it: Array, without: Array) -> Judged:
    """What held-out motion says of one name, over all joints that it acts on.

    Each joint's error counts as a share of what is left of it in any case.
    """
    on = list(change.contrast.candidate.pieces)
    least = np.minimum(with_it.sum(axis=0), without.sum(axis=0))[on]
    a, b = (x[:, on] / np.maximum(least, 1e-300) for x in (with_it, without))
    a, b = a.sum(axis=1), b.sum(axis=1)
    ratio = float(np.sqrt(a.sum() / b.sum()))
    if rise(a, b, WORSE):
        return Judged("refuted", 1 - ratio)
    word = "confirmed" if ratio < BETTER and is_sure(b, a) else "neutral"
    return Judged(word, 1 - ratio)


def _notes(found: Found) -> tuple[str, ...]:
    table, both = found.table, found.both
    seconds = both.rules.block * table.noise.blocks
    few = (
        ""
        if both.first_logs >= 3
        else ("; fewer than three logs of before: what days differ by was not seen")
    )
    return (
        f"compared on {seconds:.0f} s of motion at least in each epoch{few}",
        *(
            f"joint {j + 1}: logs of before differ by {table.noise.unrest[j]:.1f} "
            "times what noise gives"
            for j in both.live
            if table.noise.unrest[j] > 1.3
        ),
    )
