"""What the background of a used arm adds to a given motion, without simulation."""

from typing import NamedTuple

import numpy as np
from numba import njit

from residual.recording import Array
from sim.engine import friction_laws
from sim.plant.plant_arm import JointBackground, compute_start_warmth, compute_usual_friction_power


# One file with all it calls: numba keeps a function until its own file changes.
@njit(cache=True)
def _warmths(start, power, times, growth):
    """Return the warmth of oil and housing at every sample. Shape (2, n, dof).

    The friction that heats is itself what has become less by the heat.

    Args:
        start: Warmth at the first sample. Shape (2, dof).
        power: Power of cold friction over the usual one. Shape (n, dof).
        times: Time constants of oil and housing in samples. Shape (2, dof).
        growth: Cold friction over warm one, less one. Shape (dof,).
    """
    n, dof = power.shape
    out = np.empty((2, n, dof))
    out[:, 0] = start
    for i in range(1, n):
        for j in range(dof):
            oil, housing = out[0, i - 1, j], out[1, i - 1, j]
            less = 1.0 / (1.0 + growth[j] * (0.4 * oil + 0.6 * housing))
            heat = max(0.0, power[i - 1, j]) * less
            out[0, i, j] = oil + (heat - oil) / times[0, j]
            out[1, i, j] = housing + (heat - housing) / times[1, j]
    return out


class FrictionMotion(NamedTuple):
    """What friction of one motion goes by."""

    t: Array  # times [s], (n,)
    q: Array  # positions of the motors [rad], (n, dof)
    qd: Array  # speeds of the motors [rad/s], (n, dof)
    bristle: Array  # state of dry friction, -1 to 1, (n, dof)
    load: Array  # torque that the gears carry [N m], (n, dof)
    coulomb: Array  # level of the arm's dry friction [N m], (dof,)
    viscous: Array  # coefficient of its viscous friction [N m s/rad], (dof,)
    usual_speed: Array  # speed in usual work [rad/s], (dof,)
    worked: float  # time of usual work before the first sample [s]


class BackgroundTorque(NamedTuple):
    """What the background does in one motion. Shapes (n, dof)."""

    torque: Array  # torque beside the arm's plain friction [N m]
    factor: Array  # friction over that of the cold arm


def compute_background_torque(
    background: JointBackground, motion: FrictionMotion
) -> BackgroundTorque:
    """Return friction and cogging that the background adds to a motion."""
    b = background
    plain = motion.coulomb * motion.bristle + motion.viscous * motion.qd
    dry = motion.coulomb + b.level * friction_laws.low_speed_friction_factor(motion.qd, b.speed)
    dry = dry + b.press * friction_laws.hertz_contact_torque(motion.load, b.span)
    cold = dry * motion.bristle * friction_laws.directional_friction_factor(motion.bristle, b.lean)
    cold += motion.viscous * motion.qd
    start = compute_start_warmth(b, motion.worked)
    power_scale = compute_usual_friction_power(motion.coulomb, motion.viscous, motion.usual_speed)
    times = np.array([b.oil, b.housing]) / (motion.t[1] - motion.t[0])
    share = np.ascontiguousarray(cold * motion.qd / power_scale)
    warm = friction_laws.mix_contact_warmth(*_warmths(start, share, times, b.growth))
    factor = friction_laws.grease_thinning_factor(warm, b.growth)
    return BackgroundTorque(factor * cold - plain + compute_cogging(b, motion.q), factor)


def compute_cogging(background: JointBackground, q: Array) -> Array:
    """Return the torque of all waves at the positions of the motors. Shape (n, dof)."""
    b = background
    waves = b.ripple * np.sin(b.order * q[:, None, :] + b.phase)
    return waves.sum(axis=1)


def gear_twist_angle(load: Array, twist: Array, span: Array) -> Array:
    """Return twist x / sqrt(1 + x^2 / 2), x = load / span: it hardens [rad]."""
    x = load / span
    return twist * x / np.sqrt(1.0 + x * x / 2.0)
