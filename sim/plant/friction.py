"""Dry and viscous friction, solved implicitly with the motion of the whole arm.

Friction of a contact with speed u is a torque between -backward and +forward, equal to
forward for u > 0 and to -backward for u < 0, plus viscosity times u. The levels depend
on speed, load, position and temperature at the beginning of the step; which of the
three branches holds is found for the end of it. So a joint that stands still stands
still, and nothing chatters. Friction work warms, the housing cools; between motor and
link are springs with play.
"""

import math

import numpy as np
from numba import njit

from sim.engine import laws
from sim.plant.tables import compiled

_direction = njit(laws.direction)
_quadratic = njit(laws.quadratic_viscosity)
_power = njit(laws.power_viscosity)
_stribeck = njit(laws.stribeck)
_carried = njit(laws.carried)
_eccentric = njit(laws.eccentric)
_fading = njit(laws.fading)
_pressed = njit(laws.pressed)

_SWEEPS, _DONE = 200, 1e-13
# Damping of the bristles, as a share of critical on the rotor alone.
_BRISTLE_DAMPING = 0.2
AMBIENT, RISE = 20.0, 25.0  # degrees Celsius; rise at the usual power
SLOW = 600.0  # s: joints whose friction does not depend on temperature
_warmth = njit(laws.warmth)
_thinned = njit(laws.thinned)
_leaning = njit(laws.leaning)
_heated = njit(laws.heated)
_LEAN, _GROWTH, _OIL, _HOUSING, _SLOT = range(5)
# Gear teeth in play touch hard: angular frequency of the rotor on them [rad/s].
MESH = 2 * np.pi * 100.0
DAMPING = 0.05  # of critical, rotor against a fixed link


@compiled
def friction_of(row, u, angle, load, memory):
    """Return what one row adds at speed u: forward, backward, viscosity."""
    if row[0] == laws.LEVEL:
        return row[3], row[3], 0.0
    if row[0] == laws.ASYMMETRY:
        return row[3], -row[3], 0.0
    if row[0] <= laws.POWER:
        return 0.0, 0.0, _viscosity(row, u)
    level = _level(row, u, angle, load, memory)
    return level, level, 0.0


@compiled
def _viscosity(row, u):
    kind, coefficient = row[0], row[3]
    if kind == laws.VISCOUS_ASYMMETRY:
        return coefficient * _direction(u)
    if kind == laws.QUADRATIC:
        return coefficient * _quadratic(u)
    if kind == laws.POWER:
        return coefficient * _power(u, row[4])
    return coefficient


@compiled
def _level(row, u, angle, load, memory):
    kind, size, number = row[0], row[3], row[4]
    if kind == laws.STRIBECK:
        return size * _stribeck(u, number, row[5])
    if kind == laws.CARRIED:
        return size * _carried(load, number)
    if kind == laws.POSITION:
        return size * _eccentric(angle - number)
    if kind == laws.WARMUP:
        return size * max(0.0, 1.0 - memory)
    if kind == laws.FADING:
        return size * _fading(u, number)
    if kind == laws.PRESSED:
        return size * _pressed(load, number)
    return -size  # bristles bear this part of the dry friction


@compiled
def bristle(z, u, row, rotor, dt):
    """Return deflection after the step and torque of bristles (LuGre).

    dz/dt = u - |u| z / displacement, exact for constant u; torque = s0 z + s1 dz/dt.

    Args:
        row: Row of the table: level [N m], displacement [rad].
        rotor: Inertia that the damping goes by [kg m^2].
    """
    level, displacement = row[3], row[4]
    stiffness = level / displacement
    goal = displacement * np.sign(u)
    after = goal + (z - goal) * np.exp(-abs(u) * dt / displacement)
    if u == 0.0:
        after = z
    damping = 2 * _BRISTLE_DAMPING * np.sqrt(stiffness * rotor)
    return after, stiffness * after + damping * (after - z) / dt


@compiled
def slide(coupling, free, forward, backward, impulse):
    """Find the impulses of dry friction, in place.

    The speed of contact r is u_r = free_r + sum_s coupling_rs impulse_s. Wanted is,
    with -forward <= impulse <= backward: u = 0 inside, u >= 0 at -forward, u <= 0 at
    backward. Projected Gauss-Seidel from the impulses of the last step.

    Args:
        coupling: Speeds by unit impulses, positive definite. Shape (c, c).
        free: Speeds without dry friction. Shape (c,).
        forward: Largest impulse against forward motion [N m s]. Shape (c,).
        backward: Largest impulse against backward motion [N m s]. Shape (c,).
    """
    count = len(free)
    u = free.copy()
    for r in range(count):
        for s in range(count):
            u[r] += coupling[r, s] * impulse[s]
    for _ in range(_SWEEPS):
        change = 0.0
        for r in range(count):
            new = impulse[r] - u[r] / coupling[r, r]
            new = min(max(new, -forward[r]), backward[r])
            step = new - impulse[r]
            if step == 0.0:
                continue
            impulse[r] = new
            for s in range(count):
                u[s] += coupling[s, r] * step
            change = max(change, abs(step) * coupling[r, r])
        if change < _DONE:
            return


@compiled
def warmed(warmth, power, usual_power, time_constant, dt):
    """Return the warmth after a step, where 1 is the end state at the usual power.

    warmth' = (power / usual_power - warmth) / time constant
    """
    return warmth + dt / time_constant * (power / usual_power - warmth)


def warmth_at(start: float, time_constant: float) -> float:
    """Return the warmth after some time of usual work: what a session began with."""
    return 1.0 - math.exp(-start / time_constant)


@compiled
def lean_and_thin(used, memory, rubbing):
    """Make friction of each joint what it is in that direction, when so warm.

    Args:
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
def heat(used, memory, power, usual_power, temperature, dt):
    """Warm oil and housing of each joint by its friction.

    Args:
        power: Power of friction [W]. Shape (c,).
        usual_power: Power in usual work, which warms by one unit [W]. Shape (dof,).
        temperature: Written [degrees Celsius]. Shape (dof,).
    """
    for j in range(len(used)):
        slot, share = int(used[j, _SLOT]), power[j] / usual_power[j]
        warm = _warmth(memory[slot], memory[slot + 1])
        temperature[j] = AMBIENT + RISE * warm
        memory[slot] = _heated(memory[slot], share, used[j, _OIL], dt)
        memory[slot + 1] = _heated(memory[slot + 1], share, used[j, _HOUSING], dt)


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
        gap: Half of its play [rad].
        lightness: Sum of the inverse inertias on both sides [1/(kg m^2)].
    """
    if abs(twist) < gap:
        return 0.0, 0.0
    # Four times as careful as two single masses need: the links are coupled.
    swing = 4.0 * dt * dt * stiffness * lightness
    implicit = max(0.0, 0.5 - 1.0 / swing)
    stretch = twist - np.sign(twist) * gap
    return stiffness * stretch, implicit * dt * stiffness + damping
