"""What the model says in plain values: a verdict holds it without the model."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BodyCorrection:
    """What of a free fit could not exist, and what the nearest that can exist costs."""

    bodies: tuple[str, ...]  # in words, "link 5" or "the load"
    # By how much the error of each joint rose on the fit logs, as a share of torque
    # rms; below zero where it fell at the cost of another.
    price: tuple[float | None, ...]
    # Chance that logs of possible bodies are fitted so much worse by them.
    chance: float | None


@dataclass(frozen=True, slots=True)
class PositionErrors:
    """Distance of models that go by themselves from what held-out logs measured.

    Attributes:
        rms: Root mean square of each joint [rad, m where it slides], by name of the
            model; None where it diverged on a log.
        overall: The same of all joints together, None where they have two units.
        diverged: Where each model diverged, in words: log and time.
        left_out: Effects that the models went without, since their torque depends on
            more than the state.
    """

    rms: Mapping[str, tuple[float, ...] | None]
    overall: Mapping[str, float | None]
    diverged: Mapping[str, tuple[str, ...]]
    left_out: tuple[str, ...]
