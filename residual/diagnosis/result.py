"""What a diagnosis hands to its caller: the verdict and the curves behind it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from residual.model.curves import Cloud, LogProof

Array = np.ndarray


@dataclass(frozen=True, eq=False, slots=True)
class Outcome:
    """Result of one diagnosis.

    Attributes:
        verdict: The verdict in the documented JSON form (docs/verdict.md).
        sentences: One plain sentence per finding, in the order of verdict["effects"].
        proofs: One per held-out log.
        clouds: Several per finding, at most one per joint.
        notes: What was understood of the signals (rates, filters, delays, masks).
        left: One per unexplained joint, without a name: what remains, over what it
            depends on most (over time where that is not known).
    """

    verdict: Mapping
    sentences: tuple[str, ...]
    proofs: tuple[LogProof, ...]
    clouds: tuple[Cloud, ...]
    notes: tuple[str, ...]
    left: tuple[Cloud, ...] = ()
