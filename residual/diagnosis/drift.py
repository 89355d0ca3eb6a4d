"""What is told of friction that moved on all joints together."""

from dataclasses import dataclass

from residual.diagnosis.leftover.remainder import Number


@dataclass(frozen=True, slots=True)
class Drift:
    """A change of all friction, held against the baseline's.

    Attributes:
        factor: Friction now over that of the baseline.
        std: Its standard deviation.
        joints: Joints from 1 whose friction moved that way beyond two deviations.
        clock: "recording time", where baseline and logs share one; else "order".
    """

    factor: Number
    std: Number
    joints: tuple[int, ...]
    clock: str
