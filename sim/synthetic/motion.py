"""Motions of four families: positions with exact velocities and accelerations.

fourier: five harmonics (paper eq. 4); cyclic and slow_cyclic: strokes of a painting
program; move_stop_move: pick and place with real dwells. Limits hold between the
samples as well: they are imposed on bounds of the continuous curves.
"""

from dataclasses import dataclass

import numpy as np

from sim.synthetic.room import Room
from sim.synthetic.series import draw_cyclic, draw_fourier, evaluate
from sim.synthetic.stops import move_stop_move

Array = np.ndarray

FAMILIES = ("fourier", "cyclic", "slow_cyclic", "move_stop_move")


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """One motion, at rest at both ends.

    Attributes:
        family: One of FAMILIES.
        t: Time from the start [s]. Shape (n,).
        q: Positions [rad]. Shape (n, dof).
        qd: Velocities [rad/s]. Shape (n, dof).
        qdd: Accelerations [rad/s^2]. Shape (n, dof).
    """

    family: str
    t: Array
    q: Array
    qd: Array
    qdd: Array


def make_motion(
    family: str, space: Room, duration: float, rate: float, rng: np.random.Generator
) -> Motion:
    """Draw one motion.

    Args:
        duration: Length [s].
        rate: Samples per second [Hz].
        rng: Random stream; it decides the motion, the rate does not.

    Returns:
        The motion, with round(duration * rate) samples.

    Raises:
        ValueError: If there is no such family.
    """
    t = np.arange(round(duration * rate)) / rate
    match family:
        case "fourier":
            curve = draw_fourier(space, duration, rng)
        case "cyclic":
            curve = draw_cyclic(space, 5.0, 0.8, rng)
        case "slow_cyclic":
            curve = draw_cyclic(space, 10.0, 0.3, rng)
        case "move_stop_move":
            return Motion(family, t, *move_stop_move(space, t, duration, rng))
        case _:
            raise ValueError(f"No motion family {family!r}; there are {FAMILIES}.")
    return Motion(family, t, *evaluate(curve, t, duration))
