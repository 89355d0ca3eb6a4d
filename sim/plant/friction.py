"""Dry and viscous friction, solved implicitly with the motion of the whole arm.

Friction of a contact with speed u is a torque between -backward and +forward, equal to
forward for u > 0 and to -backward for u < 0, plus viscosity times u. The levels depend
on speed, load, position and temperature at the beginning of the step; which of the
three branches holds is found for the end of it. So a joint that stands still stands
still, and nothing chatters.
"""

import numpy as np
from numba import njit

from sim import kinds, laws
from sim.background import laws as used
from sim.plant.compiled import compiled

_direction = njit(laws.direction)
_quadratic = njit(laws.quadratic_viscosity)
_power = njit(laws.power_viscosity)
_stribeck = njit(laws.stribeck)
_carried = njit(laws.carried)
_eccentric = njit(laws.eccentric)
_fading = njit(used.fading)
_pressed = njit(used.pressed)

_SWEEPS, _DONE = 200, 1e-13
# Damping of the bristles, as a share of critical on the rotor alone.
_BRISTLE_DAMPING = 0.2


@compiled
def friction_of(row, u, angle, load, memory):
    """Return what one row adds at speed u: forward, backward, viscosity."""
    if row[0] == kinds.LEVEL:
        return row[3], row[3], 0.0
    if row[0] == kinds.ASYMMETRY:
        return row[3], -row[3], 0.0
    if row[0] <= kinds.POWER:
        return 0.0, 0.0, _viscosity(row, u)
    level = _level(row, u, angle, load, memory)
    return level, level, 0.0


@compiled
def _viscosity(row, u):
    kind, coefficient = row[0], row[3]
    if kind == kinds.VISCOUS_ASYMMETRY:
        return coefficient * _direction(u)
    if kind == kinds.QUADRATIC:
        return coefficient * _quadratic(u)
    if kind == kinds.POWER:
        return coefficient * _power(u, row[4])
    return coefficient


@compiled
def _level(row, u, angle, load, memory):
    kind, size, number = row[0], row[3], row[4]
    if kind == kinds.STRIBECK:
        return size * _stribeck(u, number, row[5])
    if kind == kinds.CARRIED:
        return size * _carried(load, number)
    if kind == kinds.POSITION:
        return size * _eccentric(angle - number)
    if kind == kinds.WARMUP:
        return size * max(0.0, 1.0 - memory)
    if kind == kinds.FADING:
        return size * _fading(u, number)
    if kind == kinds.PRESSED:
        return size * _pressed(load, number)
    return -size  # bristles bear this part of the dry friction


@compiled
def bristle(z, u, row, rotor, dt):
    """Return deflection after the step and torque of bristles (LuGre).

    dz/dt = u - |u| z / displacement, exact for constant u; torque = s0 z + s1 dz/dt.

    Args:
        z: Deflection before [rad].
        u: Speed [rad/s].
        row: Row of the table: level [N m], displacement [rad].
        rotor: Inertia that the damping goes by [kg m^2].
        dt: Time step [s].
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
        impulse: Impulses of the last step. Shape (c,).
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
