"""The gate for adoption: the error of a model on motion that it was not fitted to.

Each new effect is removed from it without a refit. Held-out motion must then show the
effect, on that joint and of about that size: the fraction of it that lowers the error
most is 1 for a right one, 0 on a wrong joint, -1 with a wrong sign, and 0.5 if it is
twice too large. After that the held-out logs are used up.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError, format_joint_numbers
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import (
    HeldOutLog,
    compute_joint_error_rises,
    compute_moving_error,
    compute_moving_power,
    prepare_held_out,
)
from residual.model.model import Model, Term
from residual.recording import Array, Recording


@dataclass(frozen=True, slots=True)
class VisibleShare:
    """The fraction of a new effect that held-out motion confirms."""

    name: str  # the effect
    joints: tuple[int, ...]  # joints from 1; empty for the whole arm
    # 1 if it is as in the model; None if the motion does not excite it.
    part: float | None

    @property
    def doubt(self) -> str | None:
        """Why the effect is doubtful, None if it is not."""
        if (
            self.part is None
            or THRESHOLDS.min_shown_share <= self.part <= THRESHOLDS.max_shown_share
        ):
            return None
        where = f" on {format_joint_numbers(self.joints)}" if self.joints else ""
        low, high = THRESHOLDS.min_shown_share, THRESHOLDS.max_shown_share
        return (
            f"held-out motion shows {self.part:.2f} times the {self.name}{where} of "
            f"the model, expected {low:g} to {high:g}"
        )


@dataclass(frozen=True, slots=True)
class AdoptionCheck:
    """A model compared with its predecessor."""

    # Error of all joints on held-out moving samples [%].
    before: float
    after: float
    effects: tuple[VisibleShare, ...]  # new effects
    # Why it should not be adopted, in sentences; empty if it may be.
    doubts: tuple[str, ...]


def check_adoption(model: Model, before: Model, held_out: Sequence[Recording]) -> AdoptionCheck:
    """Compare a model with its predecessor, on logs that neither was fitted to.

    Raises:
        InputError: If there is no log.
    """
    if not held_out:
        raise InputError("No held-out log given to test the model on.")
    logs = prepare_held_out(held_out, model)
    after, then = compute_moving_error(model, logs), compute_moving_error(before, logs)
    power = compute_moving_power(logs)
    had = {(t.effect.name, t.joints) for t in before.terms}
    new = [t for t in model.terms if (t.effect.name, t.joints) not in had]
    effects = tuple(_visible_share(model, term, logs) for term in new)
    figures = [100 * float(np.sqrt(e.sum() / power.sum())) for e in (then, after)]
    # A model may raise an error by as much as a finding must lower one.
    larger = compute_joint_error_rises(after, then, power, THRESHOLDS.min_fall)
    doubts = [
        *_no_better(after, then),
        *(
            f"the error of joint {j + 1} on held-out motion rises by {100 * larger[j]:.0f} %"
            for j in np.flatnonzero(larger)
        ),
    ]
    doubts += [e.doubt for e in effects if e.doubt]
    if effects and all(e.part is None for e in effects):
        doubts.append("held-out motion shows none of its new effects")
    return AdoptionCheck(*figures, effects, tuple(doubts))


def _no_better(after: Array, before: Array) -> list[str]:
    change = (before - after).sum(axis=1)
    scatter = float(np.sqrt(((change - change.mean()) ** 2).sum()))
    if change.sum() > THRESHOLDS.spared_deviations * scatter:
        return []
    factor = float(np.sqrt(after.sum() / max(before.sum(), 1e-30)))
    return [
        f"the error on held-out motion is {factor:.2f} times that of the model before, "
        "no significant improvement"
    ]


def _visible_share(model: Model, term: Term, logs: Sequence[HeldOutLog]) -> VisibleShare:
    """Weighted least squares of the residual without an effect on its torque."""
    without_term = replace(model, terms=tuple(t for t in model.terms if t is not term))
    torques, residuals = [], []
    for log in logs:
        track = log.track
        with_term, without = (track.filter(m.torque_on(track)) for m in (model, without_term))
        torques.append((with_term - without) * track.moving)
        residuals.append((track.tau - without) * track.moving)
    effect, gap = np.concatenate(torques), np.concatenate(residuals)
    # Each joint counts by the accuracy of the model on it.
    weight = 1 / np.maximum(np.mean((gap - effect) ** 2, axis=0), 1e-12)
    torque = np.sqrt(compute_moving_power(logs) / len(effect))
    visible = np.sqrt(np.mean(effect**2, axis=0)) > THRESHOLDS.silent_torque_share * np.maximum(
        torque, 1e-12
    )
    joints = tuple(j + 1 for j in term.joints)
    if not visible.any():
        return VisibleShare(term.effect.name, joints, None)
    part = (weight * effect * gap).sum() / (weight * effect**2).sum()
    return VisibleShare(term.effect.name, joints, float(part))
