"""What the held-out logs say of each name: confirmed, neutral or refuted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.examine import Examined, refit
from residual.diagnosis.gate import Tested
from residual.diagnosis.search import least
from residual.evidence.fit import Fit
from residual.evidence.states import as_model
from residual.model.compare import Errors, HeldOutLog, moving_error
from residual.model.model import Model
from residual.recording import Array

CONFIRMED = 0.01  # gain above which a name counts as confirmed
STANDING = 0.02  # share of moving rows under which a joint counts as standing
STRANGE, STRANGE_LEAST = 4.0, 0.03  # held-out error beyond that of the fit logs
SURE = 2.0  # standard errors
ROUND = 3  # gains are compared to 0.1 %


@dataclass(frozen=True, eq=False, slots=True)
class Verdicts:
    """Names that survive the held-out logs, and those that do not.

    Attributes:
        fit: Fit with the surviving names.
        kept, refuted: Members with the gain of each: the part of its joint's error on
            held-out moving samples that vanishes with it.
        dropped: Members that carry too little now that their fellows are refuted.
    """

    fit: Fit
    kept: tuple[tuple[Tested, float], ...]
    refuted: tuple[tuple[Tested, float], ...]
    dropped: tuple[Tested, ...]


def judge_held_out(examined: Examined, held_out: Sequence[HeldOutLog]) -> Verdicts:
    """Drop each name alone, refit the rest on the fit logs, predict the held-out logs.

    The worst refuted name goes first, then all are judged again.
    """
    tested, refuted, dropped = list(examined.tested), [], []
    fitted = examined.fit
    while True:
        gains = [_gain(examined, fitted, tested, t, held_out) for t in tested]
        if not gains or min(gains) >= 0:
            kept = tuple(zip(tested, gains, strict=True))
            return Verdicts(fitted, kept, tuple(refuted), tuple(dropped))
        worst = int(np.argmin(gains))
        refuted.append((tested.pop(worst), gains[worst]))
        fitted = refit(examined, tested)
        alone = [t for t in tested if not _stands(examined, fitted, t)]
        if alone:
            tested = [t for t in tested if t not in alone]
            dropped += alone
            fitted = refit(examined, tested)


def _stands(examined: Examined, fitted: Fit, one: Tested) -> bool:
    """Does a name still carry what it needs, now that others are gone?"""
    return one.nats >= least(examined.task, fitted.members, one.group)


def judgement(gain: float) -> str:
    """The verdict's word for a gain."""
    if gain < 0:
        return "refuted"
    return "confirmed" if gain >= CONFIRMED else "neutral"


def three_models(examined: Examined, judged: Verdicts) -> dict[str, Model]:
    """The three models; identified and augmented differ by nothing but the effects."""
    augmented = examined.model(judged.fit if judged.kept else examined.plain)
    identified = augmented
    if judged.kept:
        identified = examined.model(examined.plain, like=augmented)
    nominal = examined.nominal.model
    return {"nominal": nominal, "identified": identified, "augmented": augmented}


def unproven(examined: Examined, augmented: Errors) -> list[str]:
    """Sentences on joints of which the logs prove nothing, or less than it seems."""
    out = []
    design, tracks = examined.task.design, examined.logs.tracks
    every = sum(int(t.inner.sum()) for t in tracks)
    fit = np.sqrt(examined.fit.sse / design.rows) / design.rms
    held = augmented.per_joint("moving") / 100
    for j in range(design.dof):
        if design.rows[j] < STANDING * every:
            out.append(
                f"joint {j + 1} hardly moves in the fit logs: nothing can be said of it"
            )
        elif held[j] > max(STRANGE * fit[j], STRANGE_LEAST):
            out.append(
                f"joint {j + 1}: the error on held-out moving samples "
                f"({100 * held[j]:.1f} %) is {held[j] / max(fit[j], 1e-6):.0f} times "
                "that of the fit logs; the held-out motion holds something that the "
                "fit motion does not determine"
            )
    return out


def _gain(
    examined: Examined,
    fitted: Fit,
    tested: Sequence[Tested],
    one: Tested,
    held_out: Sequence[HeldOutLog],
) -> float:
    rest = [t for t in tested if t is not one]
    with_it = moving_error(as_model(examined.nominal, fitted), held_out)
    without = moving_error(as_model(examined.nominal, refit(examined, rest)), held_out)
    return round(_fall(one, with_it, without, examined.task.design.rms), ROUND)


def _fall(one: Tested, with_it: Array, without: Array, rms: Array) -> float:
    """1 - error with over error without, where the effect acts and where it shows.

    A name that only spares the model's parameters predicts as they do, so there a
    difference within its own scatter over the seconds of the logs is none.
    """
    effect, dof = one.group.effect, len(rms)
    joints = sorted({*effect.rows(one.group.joints, dof), one.seen})
    a, b = ((e / rms**2)[:, joints].sum(axis=1) for e in (with_it, without))
    change = b - a
    scatter = np.sqrt(((change - change.mean()) ** 2).sum())
    if one.by == "plausibility" and abs(change.sum()) < SURE * scatter:
        return 0.0
    return 1 - np.sqrt(a.sum() / b.sum()) if b.sum() > 0 else 0.0
