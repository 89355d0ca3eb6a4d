"""Heat of the gears: friction work warms, the housing cools."""

import math

from sim.plant.compiled import compiled

AMBIENT, RISE = 20.0, 25.0  # degrees Celsius; rise at the usual power
SLOW = 600.0  # s: joints whose friction does not depend on temperature


@compiled
def warmed(warmth, power, usual, time_constant, dt):
    """Return the warmth after a step, where 1 is the end state at the usual power.

    warmth' = (power / usual - warmth) / time constant
    """
    return warmth + dt / time_constant * (power / usual - warmth)


def warmth_at(start: float, time_constant: float) -> float:
    """Return the warmth after some time of usual work: what a session began with."""
    return 1.0 - math.exp(-start / time_constant)
