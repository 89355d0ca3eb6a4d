"""One step of the arm, compiled: from the torque of the drives to that of the joints.

Unknowns x are the speeds of the links and of those motors that are not rigidly joined
to them. With their mass matrix A, explicit torques f, viscosity and springs D, speeds
of the friction contacts u = C x and friction impulses p, the step is

    A x_new = A x + dt (f - D x_new) + C' p,    u_new = C x_new,
    u_new > 0: p = -dt F+,    u_new < 0: p = dt F-,    u_new = 0: -dt F+ <= p <= dt F-

with F+ and F- the dry friction against forward and backward motion. Which branch holds
is decided by the speed at the end of the step (Stewart and Trinkle 1996, Int. J. Numer.
Methods Eng. 39:2673): a joint at rest stays at rest, nothing chatters, and friction
takes energy at any step. Without x_new it reads

    u_new = C (A + dt D)^-1 (A x + dt f) + C (A + dt D)^-1 C' p,

a linear complementarity problem in a box, whose positive definite matrix makes the
solution unique. Projected Gauss-Seidel finds it, from the impulses of the last step
(`friction.slide`; Jourdan, Alart and Jean 1998, Comput. Methods Appl. Mech. Eng.
155:31). Bullet then moves the rigid arm by the torque that each joint passes on.
"""

import numpy as np
from numba import njit

from sim.engine import laws
from sim.plant import tables as at
from sim.plant.friction import (
    AMBIENT,
    RISE,
    bristle,
    friction_of,
    heat,
    lean_and_thin,
    slide,
    spring,
    warmed,
)
from sim.plant.tables import compiled, unpack

_hose = njit(laws.hose)
_gas_spring = njit(laws.gas_spring)
_magnet = njit(laws.magnet)
_PERIODIC = (laws.RIPPLE, laws.COGGING_SUM, laws.WAVE)


@compiled
def torque_of(row, angle, q, motor, now):
    """Return the torque with which one row resists.

    Args:
        angle: Angle of its joint, on its side of the transmission [rad].
        q: Angles of all joints, same side [rad]. Shape (dof,).
        now: Given torques of this time [N m]. Shape (s,).
    """
    kind, a, b, c = row[0], row[3], row[4], row[5]
    if kind == laws.CONSTANT:
        return a
    if kind == laws.HOSE:
        return a * _hose(angle - b)
    if kind == laws.GAS_SPRING:
        return a * _gas_spring(angle - b)
    if kind in _PERIODIC:
        return _periodic(row, angle, q)
    if kind == laws.WALL:
        return a * c * max(0.0, c * (angle - b))
    if kind == laws.SERIES:
        return now[int(a)]
    return min(max(motor, -a), a)  # dead zone: what is lost of a small torque


@compiled
def _periodic(row, angle, q):
    kind, a, b, c = row[0], row[3], row[4], row[5]
    if kind == laws.RIPPLE:
        return a * _magnet(b * angle + c)
    if kind == laws.COGGING_SUM:
        return a * np.cos(b * (angle + q[int(c)]))
    return a * np.sin(b * angle + c)


@compiled
def resist(table, q, motor_q, motor, now, channels):
    """Add up all explicit torques; write each into its channel.

    Args:
        table: Rows of torque. Shape (e, WIDTH).
        channels: Where to write, zero before [N m]. Shape (channels, dof).

    Returns:
        Torques at the link and at the motor [N m]. Shapes (dof,).
    """
    at_link, at_motor = np.zeros_like(q), np.zeros_like(q)
    for e in range(len(table)):
        row, joint = table[e], int(table[e, 1])
        inside = row[0] in laws.AT_MOTOR
        angles = motor_q if inside else q
        torque = torque_of(row, angles[joint], angles, motor[joint], now)
        channels[int(row[2]), joint] += torque
        if inside:
            at_motor[joint] += torque
        else:
            at_link[joint] += torque
    return at_link, at_motor


@compiled
def advance(k, body, outside, packed, state, trace):
    """Go one step on.

    Args:
        body: Mass matrix of the rigid arm, and below it the torque of gravity and
            speed. Shape (dof + 1, dof).
        outside: Torque from outside on the links [N m]. Shape (dof,).
        trace: Of step k the rows DRIVE, Q and QD are read, others are written.
            Shape (n, rows, dof).

    Returns:
        Torque of each joint on the rigid arm [N m]. Shape (dof,).
    """
    arm, now = unpack(packed), trace[k]
    dt, dof, motor_q = arm.dt, len(arm.rotor), state.motors[at.ANGLE]
    motor = now[at.MOTOR]
    for j in range(dof):
        drive = min(max(now[at.DRIVE, j], -arm.limit[j]), arm.limit[j])
        now[at.DRIVE, j] = drive
        motor[j] = drive * arm.ratio[j]
    at_link, at_motor = resist(
        arm.torque, now[at.Q], motor_q, motor, arm.series[k], now[at.CHANNELS :]
    )
    x = _speeds(arm, now[at.QD], state.motors[at.SPEED])
    mass, momentum = _inertia(arm, body, x)
    springs = _springs(arm, state, now[at.Q], mass, momentum)
    for j in range(dof):
        momentum[j] += dt * (outside[j] - at_link[j] - body[dof, j])
        momentum[int(arm.contacts[j, 0])] += dt * (motor[j] - at_motor[j])
    rubbing = _rub(arm, state, now, x, mass, momentum)
    x_new = _solve(arm, state, rubbing, mass, momentum)
    friction = _record_friction(arm, state, rubbing, now, x, x_new)
    for j in range(dof):
        m = int(arm.contacts[j, 0])
        now[at.ROTOR, j] = arm.rotor[j] * (x_new[m] - x[m]) / dt
        gear = motor[j] - at_motor[j] - friction[j] - now[at.ROTOR, j]
        if arm.elastic[j] > 0:
            gear = springs[0, j] + springs[1, j] * (x_new[m] - x_new[j])
            state.motors[at.SPEED, j] = x_new[m]
            motor_q[j] += dt * x_new[m]
        now[at.GEAR, j] = state.motors[at.LOADED, j] = gear
        now[at.LINK, j] = gear - at_link[j] + outside[j]
    return now[at.LINK]


@compiled
def _speeds(arm, qd, motor_qd):
    x = np.empty(len(qd) + int(arm.elastic.sum()))
    for j in range(len(qd)):
        x[j] = qd[j]
        if arm.elastic[j] > 0:
            x[int(arm.contacts[j, 0])] = motor_qd[j]
    return x


@compiled
def _inertia(arm, body, x):
    """Return the mass matrix of links, rotors and shared gears, and its momentum."""
    dof, size = len(arm.rotor), len(x)
    mass = np.zeros((size, size))
    for i in range(dof):
        for j in range(dof):
            mass[i, j] = body[i, j]
    for c in range(len(arm.contacts)):
        inertia = arm.rotor[c] if c < dof else arm.contacts[c, 5]
        _add(mass, arm.contacts[c], inertia)
    momentum = np.zeros(size)
    for i in range(size):
        for j in range(size):
            momentum[i] += mass[i, j] * x[j]
    return mass, momentum


@compiled
def _add(mass, contact, value):
    """Add value c c' to the matrix, c the direction of the contact."""
    i, j, sign = int(contact[0]), int(contact[1]), contact[2]
    mass[i, i] += value
    if j >= 0:
        mass[j, j] += value
        mass[i, j] += sign * value
        mass[j, i] += sign * value


@compiled
def _springs(arm, state, q, mass, momentum):
    """Add the transmissions; return their torque now and its growth. (2, dof)."""
    torque = np.zeros((2, len(q)))
    for j in range(len(q)):
        if arm.elastic[j] == 0:
            continue
        m = int(arm.contacts[j, 0])
        now, growth = spring(
            state.motors[at.ANGLE, j] - q[j],
            arm.stiffness[j],
            arm.damping[j],
            arm.gap[j],
            arm.dt,
            1.0 / arm.rotor[j] + 1.0 / (mass[j, j] + 1e-12),
        )
        torque[0, j], torque[1, j] = now, growth
        momentum[j] += arm.dt * now
        momentum[m] -= arm.dt * now
        mass[j, j] += arm.dt * growth
        mass[m, m] += arm.dt * growth
        mass[j, m] -= arm.dt * growth
        mass[m, j] -= arm.dt * growth
    return torque


@compiled
def _speed(contact, x):
    """Return the speed of a contact."""
    u = x[int(contact[0])]
    if contact[1] >= 0:
        u += contact[2] * x[int(contact[1])]
    return u


@compiled
def _rub(arm, state, now, x, mass, momentum):
    """Add viscosity and bristles; return both levels, viscosity, bristles. (4, c)."""
    dof, dt = len(arm.rotor), arm.dt
    rubbing = np.zeros((4, len(arm.contacts)))
    for f in range(len(arm.friction)):
        row = arm.friction[f]
        c, slot = int(row[1]), int(row[2])
        u, joint = _speed(arm.contacts[c], x), min(c, dof - 1)
        forward, backward, viscosity = friction_of(
            row, u, now[at.Q, joint], state.motors[at.LOADED, joint], state.memory[slot]
        )
        rubbing[0, c] += forward
        rubbing[1, c] += backward
        rubbing[2, c] += viscosity
        if row[0] == laws.BRISTLE:
            z, torque = bristle(state.memory[slot], u, row, arm.rotor[c], dt)
            state.memory[slot] = z
            rubbing[3, c] += torque
            momentum[int(arm.contacts[c, 0])] -= dt * torque
    for c in range(len(arm.contacts)):
        rubbing[0, c] = max(rubbing[0, c], 0.0)
        rubbing[1, c] = max(rubbing[1, c], 0.0)
    lean_and_thin(arm.used, state.memory, rubbing)
    for c in range(len(arm.contacts)):
        _add(mass, arm.contacts[c], dt * rubbing[2, c])
    return rubbing


@compiled
def _solve(arm, state, rubbing, mass, momentum):
    """Return the speeds after the step; friction impulses in place."""
    size, count = len(momentum), len(arm.contacts)
    inverse, speeds = inverted(mass), np.zeros(size)
    for i in range(size):
        for j in range(size):
            speeds[i] += inverse[i, j] * momentum[j]
    by_impulse = _contact_speeds(arm.contacts, inverse)
    coupling = _contact_speeds(arm.contacts, by_impulse)
    free = np.empty(count)
    for c in range(count):
        free[c] = _speed(arm.contacts[c], speeds)
    forward, backward = arm.dt * rubbing[0], arm.dt * rubbing[1]
    slide(coupling, free, forward, backward, state.impulse)
    for c in range(count):
        for i in range(size):
            speeds[i] += state.impulse[c] * by_impulse[c, i]
    return speeds


@compiled
def _contact_speeds(contacts, rows):
    """Return the speeds of all contacts (c) at each row of unknowns (n). (c, n)."""
    speeds = np.empty((len(contacts), len(rows)))
    # Loops: numba takes seconds to compile an assignment to a slice.
    for c in range(len(contacts)):
        for i in range(len(rows)):
            speeds[c, i] = _speed(contacts[c], rows[i])
    return speeds


@compiled
def inverted(mass):
    """Return the inverse of a small symmetric positive definite matrix.

    Gauss and Jordan without pivots: safe for such a matrix, and for six rows several
    times faster than a call of LAPACK.
    """
    a = mass.copy()
    for p in range(len(a)):
        pivot = 1.0 / a[p, p]
        a[p, p] = 1.0
        for j in range(len(a)):
            a[p, j] *= pivot
        for i in range(len(a)):
            if i != p:
                factor = a[i, p]
                a[i, p] = 0.0
                for j in range(len(a)):
                    a[i, j] -= factor * a[p, j]
    return a


@compiled
def _record_friction(arm, state, rubbing, now, x, x_new):
    """Return friction per joint, shared gears included; warm what friction heats."""
    dof, dt = len(arm.rotor), arm.dt
    power, friction = np.zeros(len(arm.contacts)), now[at.FRICTION]
    for c in range(len(arm.contacts)):
        u = _speed(arm.contacts[c], x_new)
        torque = rubbing[3, c] + rubbing[2, c] * u - state.impulse[c] / dt
        power[c] = max(0.0, torque * u)
        if c < dof:
            friction[c] += torque
            continue
        change = (u - _speed(arm.contacts[c], x)) / dt
        torque += arm.contacts[c, 5] * change
        friction[int(arm.contacts[c, 3])] += torque
        friction[int(arm.contacts[c, 4])] += arm.contacts[c, 2] * torque
    for f in range(len(arm.friction)):
        row = arm.friction[f]
        if row[0] == laws.WARMUP:
            c, slot = int(row[1]), int(row[2])
            warmth = state.memory[slot]
            now[at.TEMPERATURE, c] = AMBIENT + RISE * warmth
            state.memory[slot] = warmed(warmth, power[c], arm.power[c], row[4], dt)
    heat(arm.used, state.memory, power, arm.power, now[at.TEMPERATURE], dt)
    return friction
