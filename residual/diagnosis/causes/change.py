"""What is told of a value that the model was given, and of what the logs make of it."""

from dataclasses import dataclass

from residual.diagnosis.leftover.remainder import Number


@dataclass(frozen=True, slots=True)
class Change:
    """One value of the nominal model beside the same as the logs have it.

    Attributes:
        name: The declared effect; "inertial" for what the motion tells of the body.
        joints: Joints from 1; of the body the link that leads.
        parameter: Key of the effect's parameter; of the body the sum that it is.
        nominal: As given; with a baseline, as that has it.
        identified: As these logs have it, what was named included.
        std: Standard deviation of the difference.
        unit: SI unit.
        sigma: The difference in standard deviations.
        beyond: Whether it is beyond chance and by more than 5 %.
        explained: Whether that is said by a finding already.
    """

    name: str
    joints: tuple[int, ...]
    parameter: str
    nominal: Number
    identified: Number
    std: Number
    unit: str
    sigma: Number
    beyond: bool
    explained: bool = False
