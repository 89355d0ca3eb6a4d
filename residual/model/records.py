"""Plain values of a model for a verdict, readable without the model."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BodyCorrection:
    """Impossible bodies of a free fit, and the cost of the nearest possible ones."""

    bodies: tuple[str, ...]  # in words, "link 5" or "the load"
    # Rise of the error of each joint on the fit logs, as a share of torque rms; negative
    # where it fell at the cost of another.
    price: tuple[float | None, ...]
    # Probability of such a rise if the bodies are possible.
    chance: float | None


@dataclass(frozen=True, slots=True)
class PositionErrors:
    """Position errors of models in free simulation on held-out logs.

    Attributes:
        rms: Root mean square of each joint [rad, m where it slides], by name of the
            model; None where it diverged on a log.
        overall: The same of all joints together, None where they have two units.
        diverged: Log and time of divergence of each model, in words.
        left_out: Omitted effects, whose torque depends on more than the state.
    """

    rms: Mapping[str, tuple[float, ...] | None]
    overall: Mapping[str, float | None]
    diverged: Mapping[str, tuple[str, ...]]
    left_out: tuple[str, ...]
