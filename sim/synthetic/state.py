"""What a synthetic arm hides."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np


@dataclass(frozen=True, eq=False, slots=True)
class Hidden:
    """An effect that the arm has and its model may lack, from the beginning.

    Attributes:
        name: Name of the effect; those out of the vocabulary begin with "x_".
        joints: Joints that have it, from 1.
        parameters: SI values; an array has one entry per joint.
    """

    onset: ClassVar[float] = 0.0

    name: str
    joints: tuple[int, ...]
    parameters: Mapping[str, float | np.ndarray]
