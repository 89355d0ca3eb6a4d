"""Heat of the gears: friction work warms, the housing cools."""

import math

from numba import njit

from sim.background import laws
from sim.plant.compiled import compiled

AMBIENT, RISE = 20.0, 25.0  # degrees Celsius; rise at the usual power
SLOW = 600.0  # s: joints whose friction does not depend on temperature


_warmth = njit(laws.warmth)
_thinned = njit(laws.thinned)
_leaning = njit(laws.leaning)
_heated = njit(laws.heated)
_LEAN, _GROWTH, _OIL, _HOUSING, _SLOT = range(5)


@compiled
def warmed(warmth, power, usual, time_constant, dt):
    """Return the warmth after a step, where 1 is the end state at the usual power.

    warmth' = (power / usual - warmth) / time constant
    """
    return warmth + dt / time_constant * (power / usual - warmth)


def warmth_at(start: float, time_constant: float) -> float:
    """Return the warmth after some time of usual work: what a session began with."""
    return 1.0 - math.exp(-start / time_constant)


@compiled
def lean_and_thin(used, memory, rubbing):
    """Make friction of each joint what it is in that direction, when so warm.

    Args:
        used: Table of the background. Shape (dof or 0, 5).
        rubbing: Levels forwards and backwards, viscosity; changed in place. (4, c).
    """
    for j in range(len(used)):
        slot = int(used[j, _SLOT])
        warm = _warmth(memory[slot], memory[slot + 1])
        thin = _thinned(warm, used[j, _GROWTH])
        rubbing[0, j] *= thin * _leaning(1.0, used[j, _LEAN])
        rubbing[1, j] *= thin * _leaning(-1.0, used[j, _LEAN])
        rubbing[2, j] *= thin


@compiled
def heat(used, memory, power, usual, temperature, dt):
    """Warm oil and housing of each joint by its friction.

    Args:
        used: Table of the background. Shape (dof or 0, 5).
        memory: Of the state, changed in place.
        power: Power of friction [W]. Shape (c,).
        usual: Usual power, which warms by one unit [W]. Shape (dof,).
        temperature: Written [degrees Celsius]. Shape (dof,).
        dt: Time step [s].
    """
    for j in range(len(used)):
        slot, share = int(used[j, _SLOT]), power[j] / usual[j]
        warm = _warmth(memory[slot], memory[slot + 1])
        temperature[j] = AMBIENT + RISE * warm
        memory[slot] = _heated(memory[slot], share, used[j, _OIL], dt)
        memory[slot + 1] = _heated(memory[slot + 1], share, used[j, _HOUSING], dt)
