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
(`solve_friction_impulses`; Jourdan, Alart and Jean 1998, Comput. Methods Appl. Mech. Eng.
155:31). Bullet then moves the rigid arm by the torque that each joint passes on.

Friction of a contact with speed u is a torque between -backward and +forward, equal to
forward for u > 0 and to -backward for u < 0, plus viscosity times u. The levels depend
on speed, load, position and temperature at the beginning of the step. Friction work
warms, the housing cools; between motor and link are springs with play.
"""

import math

import numpy as np
from numba import njit

from sim.engine import friction_laws
from sim.plant import step_tables as at
from sim.plant.step_tables import compile_lazily

_direction = njit(friction_laws.smooth_motion_direction)
_quadratic = njit(friction_laws.smooth_absolute_speed)
_power = njit(friction_laws.shear_thinning_factor)
_stribeck = njit(friction_laws.stribeck_factor)
_carried = njit(friction_laws.preloaded_torque)
_eccentric = njit(friction_laws.eccentric_gear_wave)
_fading = njit(friction_laws.low_speed_friction_factor)
_pressed = njit(friction_laws.hertz_contact_torque)

_SWEEPS, _DONE = 200, 1e-13
# Damping of the bristles, as a share of critical on the rotor alone.
_BRISTLE_DAMPING = 0.2
AMBIENT, RISE = 20.0, 25.0  # degrees Celsius; rise at the usual power
SLOW = 600.0  # s: joints whose friction does not depend on temperature
_warmth = njit(friction_laws.mix_contact_warmth)
_thinned = njit(friction_laws.grease_thinning_factor)
_leaning = njit(friction_laws.directional_friction_factor)
_heated = njit(friction_laws.step_warmth)
_LEAN, _GROWTH, _OIL, _HOUSING, _SLOT = range(5)
# Gear teeth in play touch hard: angular frequency of the rotor on them [rad/s].
MESH = 2 * np.pi * 100.0
DAMPING = 0.05  # of critical, rotor against a fixed link


@compile_lazily
def compute_row_friction(row, u, angle, load, memory):
    """Return the friction of one row at speed u: forward, backward, viscosity."""
    if row[0] == friction_laws.LEVEL:
        return row[3], row[3], 0.0
    if row[0] == friction_laws.ASYMMETRY:
        return row[3], -row[3], 0.0
    if row[0] <= friction_laws.POWER:
        return 0.0, 0.0, _viscosity(row, u)
    level = _level(row, u, angle, load, memory)
    return level, level, 0.0


@compile_lazily
def _viscosity(row, u):
    kind, coefficient = row[0], row[3]
    if kind == friction_laws.VISCOUS_ASYMMETRY:
        return coefficient * _direction(u)
    if kind == friction_laws.QUADRATIC:
        return coefficient * _quadratic(u)
    if kind == friction_laws.POWER:
        return coefficient * _power(u, row[4])
    return coefficient


@compile_lazily
def _level(row, u, angle, load, memory):
    kind, size, number = row[0], row[3], row[4]
    if kind == friction_laws.STRIBECK:
        return size * _stribeck(u, number, row[5])
    if kind == friction_laws.CARRIED:
        return size * _carried(load, number)
    if kind == friction_laws.POSITION:
        return size * _eccentric(angle - number)
    if kind == friction_laws.WARMUP:
        return size * max(0.0, 1.0 - memory)
    if kind == friction_laws.FADING:
        return size * _fading(u, number)
    if kind == friction_laws.PRESSED:
        return size * _pressed(load, number)
    return -size  # share of the dry friction in the bristles


@compile_lazily
def step_bristle(deflection, u, row, rotor, dt):
    """Return deflection after the step and torque of bristles (LuGre).

    dz/dt = u - |u| z / displacement, exact for constant u; torque = s0 z + s1 dz/dt.

    Args:
        row: Row of the table: level [N m], displacement [rad].
        rotor: Inertia that sets the damping [kg m^2].
    """
    level, displacement = row[3], row[4]
    stiffness = level / displacement
    goal = displacement * np.sign(u)
    after = goal + (deflection - goal) * np.exp(-abs(u) * dt / displacement)
    if u == 0.0:
        after = deflection
    damping = 2 * _BRISTLE_DAMPING * np.sqrt(stiffness * rotor)
    return after, stiffness * after + damping * (after - deflection) / dt


@compile_lazily
def solve_friction_impulses(coupling, frictionless_speeds, forward, backward, impulse):
    """Find the impulses of dry friction, in place.

    The speed of contact r is u_r = free_r + sum_s coupling_rs impulse_s. The solution
    has -forward <= impulse <= backward: u = 0 inside, u >= 0 at -forward, u <= 0 at
    backward. Projected Gauss-Seidel from the impulses of the last step.

    Args:
        coupling: Speeds by unit impulses, positive definite. Shape (c, c).
        frictionless_speeds: Speeds without dry friction. Shape (c,).
        forward: Largest impulse against forward motion [N m s]. Shape (c,).
        backward: Largest impulse against backward motion [N m s]. Shape (c,).
    """
    count = len(frictionless_speeds)
    u = frictionless_speeds.copy()
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


def compute_warmth_after(working_time: float, time_constant: float) -> float:
    """Return the warmth after some time of typical work, at the start of a session."""
    return 1.0 - math.exp(-working_time / time_constant)


@compile_lazily
def scale_background_friction(background, memory, levels):
    """Scale the friction of each joint by direction and warmth.

    Args:
        levels: Levels forwards and backwards, viscosity; changed in place. (4, c).
    """
    for j in range(len(background)):
        slot = int(background[j, _SLOT])
        warm = _warmth(memory[slot], memory[slot + 1])
        thin = _thinned(warm, background[j, _GROWTH])
        levels[0, j] *= thin * _leaning(1.0, background[j, _LEAN])
        levels[1, j] *= thin * _leaning(-1.0, background[j, _LEAN])
        levels[2, j] *= thin


@compile_lazily
def step_background_warmth(background, memory, power, usual_power, temperature, dt):
    """Warm oil and housing of each joint by its friction.

    Args:
        power: Power of friction [W]. Shape (c,).
        usual_power: Power in typical work, which warms by one unit [W]. Shape (dof,).
        temperature: Written [degrees Celsius]. Shape (dof,).
    """
    for j in range(len(background)):
        slot, share = int(background[j, _SLOT]), power[j] / usual_power[j]
        warm = _warmth(memory[slot], memory[slot + 1])
        temperature[j] = AMBIENT + RISE * warm
        memory[slot] = _heated(memory[slot], share, background[j, _OIL], dt)
        memory[slot + 1] = _heated(memory[slot + 1], share, background[j, _HOUSING], dt)


def combine_springs(compliances: list[float], gaps: list[float], rotor: float) -> tuple:
    """Return stiffness, damping and half gap of springs and gears in series.

    Args:
        compliances: Inverse stiffness of each spring [rad/(N m)].
        gaps: Half gap of each gear [rad].
        rotor: Inertia of the motor [kg m^2].
    """
    if gaps:
        compliances = [*compliances, 1.0 / (rotor * MESH**2)]
    stiffness = 1.0 / sum(compliances)
    return stiffness, 2 * DAMPING * np.sqrt(stiffness * rotor), sum(gaps)


@compile_lazily
def compute_spring_torque(twist, stiffness, damping, gap, dt, inverse_inertia):
    """Return the present torque of a spring with play, and its growth with speed.

    Torque after the step = now + growth * (motor speed - link speed), both after it.
    A share of the step is taken implicitly: none where the spring is soft, which keeps
    its energy, and up to half where it is stiff, which is stable for any step.

    Args:
        twist: Motor minus link angle [rad].
        gap: Half of its play [rad].
        inverse_inertia: Sum of the inverse inertias on both sides [1/(kg m^2)].
    """
    if abs(twist) < gap:
        return 0.0, 0.0
    # A margin of four over two single masses: the links are coupled.
    swing = 4.0 * dt * dt * stiffness * inverse_inertia
    implicit = max(0.0, 0.5 - 1.0 / swing)
    stretch = twist - np.sign(twist) * gap
    return stiffness * stretch, implicit * dt * stiffness + damping


_hose = njit(friction_laws.hose_deflection)
_gas_spring = njit(friction_laws.gas_spring_torque)
_magnet = njit(friction_laws.motor_cogging_wave)


@compile_lazily
def compute_row_torque(row, angle, q, motor, series_torques):
    """Return the torque with which one row resists.

    Args:
        angle: Angle of its joint, on its side of the transmission [rad].
        q: Angles of all joints, same side [rad]. Shape (dof,).
        series_torques: Given torques of this time [N m]. Shape (s,).
    """
    kind, a, b, c = row[0], row[3], row[4], row[5]
    if kind == friction_laws.CONSTANT:
        return a
    if kind == friction_laws.HOSE:
        return a * _hose(angle - b)
    if kind == friction_laws.GAS_SPRING:
        return a * _gas_spring(angle - b)
    if kind == friction_laws.RIPPLE:
        return a * _magnet(b * angle + c)
    if kind == friction_laws.COGGING_SUM:
        return a * np.cos(b * (angle + q[int(c)]))
    if kind == friction_laws.WAVE:
        return a * np.sin(b * angle + c)
    if kind == friction_laws.WALL:
        return a * c * max(0.0, c * (angle - b))
    if kind == friction_laws.SERIES:
        return series_torques[int(a)]
    return min(max(motor, -a), a)  # dead zone: the lost part of a torque


@compile_lazily
def sum_explicit_torques(table, q, motor_q, motor, series_torques, channels):
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
        inside = row[0] in friction_laws.AT_MOTOR
        angles = motor_q if inside else q
        torque = compute_row_torque(row, angles[joint], angles, motor[joint], series_torques)
        channels[int(row[2]), joint] += torque
        if inside:
            at_motor[joint] += torque
        else:
            at_link[joint] += torque
    return at_link, at_motor


@compile_lazily
def step_drive_train(k, rigid_dynamics, external_torque, arm, state, trace):
    """Advance by one step.

    Args:
        rigid_dynamics: Mass matrix of the rigid arm, and below it the torque of
            gravity and speed. Shape (dof + 1, dof).
        external_torque: Torque from outside on the links [N m]. Shape (dof,).
        trace: Of step k the rows DRIVE, Q and QD are read, others are written.
            Shape (n, rows, dof).

    Returns:
        Torque of each joint on the rigid arm [N m]. Shape (dof,).
    """
    now, dt = trace[k], arm.dt
    dof, motor_q = arm.joints.shape[1], state.motors[at.ANGLE]
    motor = now[at.MOTOR]
    for j in range(dof):
        drive = min(max(now[at.DRIVE, j], -arm.joints[at.LIMIT, j]), arm.joints[at.LIMIT, j])
        now[at.DRIVE, j] = drive
        motor[j] = drive * arm.joints[at.RATIO, j]
    at_link, at_motor = sum_explicit_torques(
        arm.torque, now[at.Q], motor_q, motor, arm.series[k], now[at.CHANNELS :]
    )
    x = np.empty(dof + int(arm.joints[at.ELASTIC].sum()))
    for j in range(dof):
        x[j] = now[at.QD, j]
        if arm.joints[at.ELASTIC, j] > 0:
            x[int(arm.contacts[j, 0])] = state.motors[at.SPEED, j]
    mass, momentum = _inertia(arm, rigid_dynamics, x)
    springs = _springs(arm, state, now[at.Q], mass, momentum)
    for j in range(dof):
        momentum[j] += dt * (external_torque[j] - at_link[j] - rigid_dynamics[dof, j])
        momentum[int(arm.contacts[j, 0])] += dt * (motor[j] - at_motor[j])
    rubbing = _rub(arm, state, now, x, mass, momentum)
    x_new = _solve(arm, state, rubbing, mass, momentum)
    friction = _record_friction(arm, state, rubbing, now, x, x_new)
    for j in range(dof):
        m = int(arm.contacts[j, 0])
        now[at.ROTOR, j] = arm.joints[at.INERTIA, j] * (x_new[m] - x[m]) / dt
        gear = motor[j] - at_motor[j] - friction[j] - now[at.ROTOR, j]
        if arm.joints[at.ELASTIC, j] > 0:
            gear = springs[0, j] + springs[1, j] * (x_new[m] - x_new[j])
            state.motors[at.SPEED, j] = x_new[m]
            motor_q[j] += dt * x_new[m]
        now[at.GEAR, j] = state.motors[at.LOADED, j] = gear
        now[at.LINK, j] = gear - at_link[j] + external_torque[j]
    return now[at.LINK]


@compile_lazily
def _inertia(arm, body, x):
    """Return the mass matrix of links, rotors and shared gears, and its momentum."""
    dof, size = arm.joints.shape[1], len(x)
    mass = np.zeros((size, size))
    for i in range(dof):
        for j in range(dof):
            mass[i, j] = body[i, j]
    for c in range(len(arm.contacts)):
        inertia = arm.joints[at.INERTIA, c] if c < dof else arm.contacts[c, 5]
        _add(mass, arm.contacts[c], inertia)
    momentum = np.zeros(size)
    for i in range(size):
        for j in range(size):
            momentum[i] += mass[i, j] * x[j]
    return mass, momentum


@compile_lazily
def _add(mass, contact, value):
    """Add value c c' to the matrix, c the direction of the contact."""
    i, j, sign = int(contact[0]), int(contact[1]), contact[2]
    mass[i, i] += value
    if j >= 0:
        mass[j, j] += value
        mass[i, j] += sign * value
        mass[j, i] += sign * value


@compile_lazily
def _springs(arm, state, q, mass, momentum):
    """Add the transmissions; return their torque now and its growth. (2, dof)."""
    torque = np.zeros((2, len(q)))
    for j in range(len(q)):
        if arm.joints[at.ELASTIC, j] == 0:
            continue
        m = int(arm.contacts[j, 0])
        now, growth = compute_spring_torque(
            state.motors[at.ANGLE, j] - q[j],
            arm.joints[at.STIFFNESS, j],
            arm.joints[at.DAMPING, j],
            arm.joints[at.GAP, j],
            arm.dt,
            1.0 / arm.joints[at.INERTIA, j] + 1.0 / (mass[j, j] + 1e-12),
        )
        torque[0, j], torque[1, j] = now, growth
        momentum[j] += arm.dt * now
        momentum[m] -= arm.dt * now
        mass[j, j] += arm.dt * growth
        mass[m, m] += arm.dt * growth
        mass[j, m] -= arm.dt * growth
        mass[m, j] -= arm.dt * growth
    return torque


@compile_lazily
def _speed(contact, x):
    """Return the speed of a contact."""
    u = x[int(contact[0])]
    if contact[1] >= 0:
        u += contact[2] * x[int(contact[1])]
    return u


@compile_lazily
def _rub(arm, state, now, x, mass, momentum):
    """Add viscosity and bristles; return levels both ways, viscosity, bristles. (4, c)."""
    dof, dt = arm.joints.shape[1], arm.dt
    rubbing = np.zeros((4, len(arm.contacts)))
    for f in range(len(arm.friction)):
        row = arm.friction[f]
        c, slot = int(row[1]), int(row[2])
        u, joint = _speed(arm.contacts[c], x), min(c, dof - 1)
        forward, backward, viscosity = compute_row_friction(
            row, u, now[at.Q, joint], state.motors[at.LOADED, joint], state.memory[slot]
        )
        rubbing[0, c] += forward
        rubbing[1, c] += backward
        rubbing[2, c] += viscosity
        if row[0] == friction_laws.BRISTLE:
            z, torque = step_bristle(state.memory[slot], u, row, arm.joints[at.INERTIA, c], dt)
            state.memory[slot] = z
            rubbing[3, c] += torque
            momentum[int(arm.contacts[c, 0])] -= dt * torque
    for c in range(len(arm.contacts)):
        rubbing[0, c] = max(rubbing[0, c], 0.0)
        rubbing[1, c] = max(rubbing[1, c], 0.0)
    scale_background_friction(arm.used, state.memory, rubbing)
    for c in range(len(arm.contacts)):
        _add(mass, arm.contacts[c], dt * rubbing[2, c])
    return rubbing


@compile_lazily
def _solve(arm, state, rubbing, mass, momentum):
    """Return the speeds after the step; friction impulses in place."""
    size, count = len(momentum), len(arm.contacts)
    inverse, speeds = invert_mass_matrix(mass), np.zeros(size)
    for i in range(size):
        for j in range(size):
            speeds[i] += inverse[i, j] * momentum[j]
    by_impulse = _contact_speeds(arm.contacts, inverse)
    coupling = _contact_speeds(arm.contacts, by_impulse)
    free = np.empty(count)
    for c in range(count):
        free[c] = _speed(arm.contacts[c], speeds)
    forward, backward = arm.dt * rubbing[0], arm.dt * rubbing[1]
    solve_friction_impulses(coupling, free, forward, backward, state.impulse)
    for c in range(count):
        for i in range(size):
            speeds[i] += state.impulse[c] * by_impulse[c, i]
    return speeds


@compile_lazily
def _contact_speeds(contacts, rows):
    """Return the speeds of all contacts (c) at each row of unknowns (n). (c, n)."""
    speeds = np.empty((len(contacts), len(rows)))
    # Loops: numba takes seconds to compile an assignment to a slice.
    for c in range(len(contacts)):
        for i in range(len(rows)):
            speeds[c, i] = _speed(contacts[c], rows[i])
    return speeds


@compile_lazily
def invert_mass_matrix(mass):
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


@compile_lazily
def _record_friction(arm, state, rubbing, now, x, x_new):
    """Return friction per joint, shared gears included; update the temperatures."""
    dof, dt = arm.joints.shape[1], arm.dt
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
        if row[0] == friction_laws.WARMUP:
            c, slot = int(row[1]), int(row[2])
            warmth = state.memory[slot]
            now[at.TEMPERATURE, c] = AMBIENT + RISE * warmth
            state.memory[slot] = _heated(warmth, power[c] / arm.joints[at.POWER, c], row[4], dt)
    step_background_warmth(
        arm.used, state.memory, power, arm.joints[at.POWER], now[at.TEMPERATURE], dt
    )
    return friction
