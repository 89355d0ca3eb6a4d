"""What a model is worth on motion that it was not fitted to: may it be adopted?

Each effect that is new in it is taken out again, and nothing is refitted. Held-out
motion must then show it, on that joint and of about that size: the part of it that
lowers the error most is 1 for a right one, 0 on a wrong joint, -1 with a wrong sign,
and 0.5 where it is twice as large as it should be.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError
from residual.evidence.rules import RULES
from residual.model.chance import rises
from residual.model.compare import (
    HeldOutLog,
    moving_error,
    moving_power,
    prepare_held_out,
)
from residual.model.model import Model, Term
from residual.names import joints_listed
from residual.recording import Array, Recording


@dataclass(frozen=True, slots=True)
class Shown:
    """How much of a new effect held-out motion shows.

    Attributes:
        name: The effect.
        joints: Joints from 1; empty for the whole arm.
        part: 1 where it is there as the model has it; None where the motion does not
            show it.
    """

    name: str
    joints: tuple[int, ...]
    part: float | None

    @property
    def doubt(self) -> str | None:
        """Why it is not as the model has it, None where nothing speaks against it."""
        if self.part is None or RULES.least_shown <= self.part <= RULES.most_shown:
            return None
        where = f" on {joints_listed(self.joints)}" if self.joints else ""
        return (
            f"held-out motion shows {self.part:.2f} times the {self.name}{where} of "
            f"the model, expected {RULES.least_shown:g} to {RULES.most_shown:g}"
        )


@dataclass(frozen=True, slots=True)
class Worth:
    """What a model is worth beside the one before it.

    Attributes:
        before, after: Error of all joints on held-out moving samples [%].
        effects: What is new in it.
        doubts: Why it should not be adopted, in sentences; empty for a model that may.
    """

    before: float
    after: float
    effects: tuple[Shown, ...]
    doubts: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether it may be adopted."""
        return not self.doubts


def worth(model: Model, before: Model, held_out: Sequence[Recording]) -> Worth:
    """Hold a model against the one before it, on logs that neither was fitted to.

    Raises:
        InputError: If there is no log.
    """
    if not held_out:
        raise InputError("No held-out log: a model is judged by motion unseen by it.")
    logs = prepare_held_out(held_out, model)
    after, then = moving_error(model, logs), moving_error(before, logs)
    power = moving_power(logs)
    effects = tuple(_shown(model, term, logs) for term in _new(model, before))
    figures = [100 * float(np.sqrt(e.sum() / power.sum())) for e in (then, after)]
    doubts = [*_no_better(after, then), *_harms(after, then, power)]
    doubts += [e.doubt for e in effects if e.doubt]
    if effects and all(e.part is None for e in effects):
        doubts.append("held-out motion shows none of what is new in it")
    return Worth(*figures, effects, tuple(doubts))


def _new(model: Model, before: Model) -> list[Term]:
    had = {(t.effect.name, t.joints) for t in before.terms}
    return [t for t in model.terms if (t.effect.name, t.joints) not in had]


def _no_better(after: Array, before: Array) -> list[str]:
    """Whether the error falls by more than chance, over the seconds of the logs."""
    change = (before - after).sum(axis=1)
    scatter = float(np.sqrt(((change - change.mean()) ** 2).sum()))
    if change.sum() > RULES.sure_spared * scatter:
        return []
    factor = float(np.sqrt(after.sum() / max(before.sum(), 1e-30)))
    return [
        f"the error on held-out motion is {factor:.2f} times that of the model before, "
        "which is no clear fall"
    ]


def _harms(after: Array, before: Array, power: Array) -> list[str]:
    rise = rises(after, before, power)
    return [
        f"the error of joint {j + 1} on held-out motion rises by {100 * rise[j]:.0f} %"
        for j in np.flatnonzero(rise)
    ]


def _shown(model: Model, term: Term, logs: Sequence[HeldOutLog]) -> Shown:
    """Weighted least squares of what is left without an effect on the effect itself."""
    rest = replace(model, terms=tuple(t for t in model.terms if t is not term))
    own, left = [], []
    for log in logs:
        track = log.track
        whole, without = (track.filter(m.torque_on(track)) for m in (model, rest))
        own.append((whole - without) * track.moving)
        left.append((track.tau - without) * track.moving)
    effect, gap = np.concatenate(own), np.concatenate(left)
    # Each joint counts by how well the model knows it.
    weight = 1 / np.maximum(np.mean((gap - effect) ** 2, axis=0), 1e-12)
    torque = np.sqrt(moving_power(logs) / len(effect))
    seen = np.sqrt(np.mean(effect**2, axis=0)) > RULES.silent * np.maximum(
        torque, 1e-12
    )
    joints = tuple(j + 1 for j in term.joints)
    if not seen.any():
        return Shown(term.effect.name, joints, None)
    part = (weight * effect * gap).sum() / (weight * effect**2).sum()
    return Shown(term.effect.name, joints, float(part))
