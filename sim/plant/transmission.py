"""Between motor and link: springs with play."""

import numpy as np

from sim.plant.compiled import compiled

# Gear teeth in play touch hard: angular frequency of the rotor on them [rad/s].
MESH = 2 * np.pi * 100.0
DAMPING = 0.05  # of critical, rotor against a fixed link


def series_spring(compliances: list[float], gaps: list[float], rotor: float) -> tuple:
    """Return stiffness, damping and half gap of springs and gears in one line.

    Args:
        compliances: Inverse stiffness of each spring [rad/(N m)].
        gaps: Half gap of each gear [rad].
        rotor: Inertia of the motor [kg m^2].
    """
    if gaps:
        compliances = [*compliances, 1.0 / (rotor * MESH**2)]
    stiffness = 1.0 / sum(compliances)
    return stiffness, 2 * DAMPING * np.sqrt(stiffness * rotor), sum(gaps)


@compiled
def spring(twist, stiffness, damping, gap, dt, lightness):
    """Return the torque of a spring with play now, and how it grows with speed.

    Torque after the step = now + growth * (motor speed - link speed), both after it.
    A share of the step is taken implicitly: none where the spring is soft, which keeps
    its energy, and up to half where it is stiff, which is stable for any step.

    Args:
        twist: Motor minus link angle [rad].
        stiffness: Of the spring [N m/rad].
        damping: Of the spring [N m s/rad].
        gap: Half of its play [rad].
        dt: Time step [s].
        lightness: Sum of the inverse inertias on both sides [1/(kg m^2)].
    """
    if abs(twist) < gap:
        return 0.0, 0.0
    # Four times as careful as two single masses need: the links are coupled.
    swing = 4.0 * dt * dt * stiffness * lightness
    implicit = max(0.0, 0.5 - 1.0 / swing)
    stretch = twist - np.sign(twist) * gap
    return stiffness * stretch, implicit * dt * stiffness + damping
