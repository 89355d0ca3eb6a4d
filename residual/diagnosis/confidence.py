"""How sure a name is: the share of names like it that proved right on known arms.

Evidence counts on noise that is noise. Where a joint keeps more than that, as those of
measured arms do, it says too much: so there a logistic curve weighs it with the parts
of the logs that show the name again and with what held-out motion gains by it. The
curve was fitted on names of measured logs with effects added, whose truth is known
(METHOD 17; docs/benchmarks.md says how well it holds on arms left out of the fit).
"""

from dataclasses import dataclass

import numpy as np

from residual.diagnosis.gate import Tested
from residual.diagnosis.result import Splits
from residual.effects.base import Trait

SURE = 0.9  # probability from which a name is in the model and in the headline
MOST_GAIN = 0.3  # more of a gain makes no name surer
# Gain from which a name is something although each of its sizes may be nothing: a
# gap whose flight is another than the formula's takes an eighth of its joint's error.
PROVEN = 0.1


@dataclass(frozen=True, slots=True)
class Curve:
    """Log odds of a name: a level, and weights of what speaks for it."""

    level: float
    nats: float  # of log(1 + nats)
    parts: float  # of the share of parts of the logs that show it again
    gain: float  # of the part of the held-out error that it removes, over MOST_GAIN


# 70 names of 8 measured arms, seed 1 of `benchmarks/measured_parts/known.py`.
CURVE = Curve(level=-3.10, nats=0.41, parts=1.88, gain=2.59)
# Of a constant, whose evidence is no measure (it is tested on left-out parts): 24 of
# the same and of simulated arms; the level 0.2 under the fit, as few of them are false.
OF_CONSTANTS = Curve(level=-1.60, nats=0.0, parts=2.34, gain=3.28)


def confidence(tested: Tested, gain: float, splits: Splits) -> float:
    """Probability that a name is right, on a joint that keeps more than noise.

    Args:
        gain: Part of the held-out error that it removes.
        splits: How many parts of the logs show it again.
    """
    curve = OF_CONSTANTS if Trait.CONSTANT in tested.group.effect.traits else CURVE
    parts = splits.found / splits.of if splits.of else 0.5
    gained = float(np.clip(gain / MOST_GAIN, -1.0, 1.0))
    odds = curve.level + curve.nats * np.log1p(max(tested.nats, 0.0))
    odds += curve.parts * parts + curve.gain * gained
    return float(1 / (1 + np.exp(-odds)))
