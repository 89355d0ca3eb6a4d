"""The leftover of one examined, looked at and corrected, with the sentences on it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.examine import Examined
from residual.diagnosis.leftover.correction import corrected
from residual.diagnosis.leftover.leftover import Leftover, leftovers
from residual.evidence.fit import Fit
from residual.model.corrected import Corrected
from residual.model.model import Model

SHARED = 0.6  # squared loading on a component from which a joint belongs to it
SURE = 3.0  # standard deviations of a correlation of so few effective rows


@dataclass(frozen=True, eq=False, slots=True)
class Remains:
    """What is known of the leftover.

    Attributes:
        joints: One entry per unexplained joint.
        correction: The model with a statistical correction; None where nothing is
            left, or no joint can be checked.
        sentences: Sentences.
    """

    joints: tuple[Leftover, ...]
    correction: Corrected | None
    sentences: tuple[str, ...]


def examine_leftover(examined: Examined, fitted: Fit, augmented: Model) -> Remains:
    """Look at what the names leave on the fit logs; nothing held out has a part.

    Args:
        examined: The diagnosis.
        fitted: Fit of exactly the names that stand.
        augmented: The model made of it.
    """
    told, tracks = examined.adequacy, examined.logs.tracks
    found = leftovers(examined.task.design, tracks, fitted, told)
    made = corrected(augmented, tracks, found)
    said = [_helpless(made), shared_source(examined, fitted)]
    return Remains(found, made, tuple(s for s in said if s))


def shared_source(examined: Examined, fitted: Fit) -> str | None:
    """Say so if one principal component holds what several joints keep.

    Leftovers are scaled to unit variance and compared on rows where both joints move.
    """
    joints = list(examined.adequacy.doubted)
    if len(joints) < 2:
        return None
    lines = np.stack([_line(examined, fitted, j) for j in joints])
    use = np.stack([_used(examined, j) for j in joints])
    power = lines**2 @ use.T
    correlation = lines @ lines.T / np.sqrt(np.maximum(power * power.T, 1e-300))
    values, vectors = np.linalg.eigh(correlation)
    loading = values[-1] * vectors[:, -1] ** 2
    belong = [j for j, part in zip(joints, loading, strict=True) if part > SHARED]
    chance = SURE / np.sqrt(fitted.counted[joints].min())
    if len(belong) < 2 or values[-1] - 1 < chance * (len(joints) - 1):
        return None
    share = 100 * loading[[joints.index(j) for j in belong]].mean()
    return (
        f"what joints {_list(belong)} keep moves together (one component holds "
        f"{share:.0f} % of it): look for one source"
    )


def _helpless(made: Corrected | None) -> str | None:
    if made is None or not made.helpless:
        return None
    many = "s" if len(made.helpless) > 1 else ""
    return (
        f"joint{many} {_list(made.helpless)}: not correctable from state: tables of "
        "position, speed, acceleration and load do not help on logs left out"
    )


def _line(examined: Examined, fitted: Fit, j: int) -> np.ndarray:
    """Leftover of a joint on the common time line, 0 where it does not move."""
    design = examined.task.design
    left = design.residual(j, fitted.ids, fitted.theta)
    return np.concatenate(design.series(j, left))


def _used(examined: Examined, j: int) -> np.ndarray:
    design = examined.task.design
    return np.concatenate(design.series(j, np.ones(len(design.target[j]))))


def _list(joints: Sequence[int]) -> str:
    return ", ".join(str(j + 1) for j in joints)
