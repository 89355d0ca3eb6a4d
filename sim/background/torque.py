"""What the background adds to a synthetic arm, and what its drives make of torque."""

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from sim.background import laws
from sim.background.draw import Background
from sim.background.heat import warmth_after, warmths

Array = np.ndarray

USUAL_SPEED = 0.35  # of the speed of the robot's room


class Rubbing(NamedTuple):
    """What friction of one motion goes by.

    Attributes:
        t: Times [s]. Shape (n,).
        q: Positions of the motors [rad]. Shape (n, dof).
        qd: Speeds of the motors [rad/s]. Shape (n, dof).
        bristle: State of dry friction, -1 to 1. Shape (n, dof).
        load: Torque that the gears carry [N m]. Shape (n, dof).
        coulomb: Level of the arm's dry friction [N m]. Shape (dof,).
        viscous: Coefficient of its viscous friction [N m s/rad]. Shape (dof,).
        usual: Speed in usual work [rad/s]. Shape (dof,).
        worked: Time of usual work before the first sample [s].
    """

    t: Array
    q: Array
    qd: Array
    bristle: Array
    load: Array
    coulomb: Array
    viscous: Array
    usual: Array
    worked: float


class Added(NamedTuple):
    """What the background does in one motion. Shapes (n, dof).

    Attributes:
        torque: Torque beside the arm's plain friction [N m].
        factor: Friction over that of the cold arm.
    """

    torque: Array
    factor: Array


def added(background: Background, arm: Rubbing) -> Added:
    """Return friction and cogging that the background adds to a motion."""
    b = background
    plain = arm.coulomb * arm.bristle + arm.viscous * arm.qd
    dry = arm.coulomb + b.level * laws.fading(arm.qd, b.speed)
    dry = dry + b.press * laws.pressed(arm.load, b.span)
    cold = dry * arm.bristle * laws.leaning(arm.bristle, b.lean)
    cold += arm.viscous * arm.qd
    factor = _factor(b, arm, cold * arm.qd)
    return Added(factor * cold - plain + cogging(b, arm.q), factor)


def cogging(background: Background, q: Array) -> Array:
    """Return the torque of all waves at the positions of the motors. Shape (n, dof)."""
    b = background
    waves = b.ripple * np.sin(b.order * q[:, None, :] + b.phase)
    return waves.sum(axis=1)


def usual_power(coulomb: Array, viscous: Array, speed: Array) -> Array:
    """Return the power of friction in usual work, which warms by one unit [W]."""
    return coulomb * speed + viscous * speed**2 + 1e-9


def logged(background: Background | None, tau: Array, rate: float) -> Array:
    """Return what is logged of a torque: through a low pass, in whole steps [N m].

    Args:
        background: That of the arm; a clean one logs what it is given.
        tau: Torque with its noise [N m]. Shape (n, dof).
        rate: Samples per second [Hz].
    """
    if background is None:
        return tau
    out = np.empty_like(tau)
    for j, corner in enumerate(background.cutoff):
        keep = np.exp(-2 * np.pi * corner / rate)
        at_rest = [keep * tau[0, j]]
        out[:, j], _ = lfilter([1 - keep], [1, -keep], tau[:, j], zi=at_rest)
    return np.round(out / background.step) * background.step


def _factor(b: Background, arm: Rubbing, power: Array) -> Array:
    """Return friction over cold friction at every sample. Shape (n, dof)."""
    start = warmth_after(b, arm.worked)
    usual = usual_power(arm.coulomb, arm.viscous, arm.usual)
    times = np.array([b.oil, b.housing]) / (arm.t[1] - arm.t[0])
    warm = laws.warmth(*warmths(start, power / usual, times, b.growth))
    return laws.thinned(warm, b.growth)
