"""Torques that follow from position, time or command: no solver needed."""

import numpy as np
from numba import njit

from sim import kinds, laws
from sim.plant.compiled import compiled

_hose = njit(laws.hose)
_gas_spring = njit(laws.gas_spring)
_magnet = njit(laws.magnet)
_PERIODIC = (kinds.RIPPLE, kinds.COGGING_SUM, kinds.WAVE)


@compiled
def torque_of(row, angle, q, motor, now):
    """Return the torque with which one row resists.

    Args:
        angle: Angle of its joint, on its side of the transmission [rad].
        q: Angles of all joints, same side [rad]. Shape (dof,).
        motor: Torque of the motor [N m].
        now: Given torques of this time [N m]. Shape (s,).
    """
    kind, a, b, c = row[0], row[3], row[4], row[5]
    if kind == kinds.CONSTANT:
        return a
    if kind == kinds.HOSE:
        return a * _hose(angle - b)
    if kind == kinds.GAS_SPRING:
        return a * _gas_spring(angle - b)
    if kind in _PERIODIC:
        return _periodic(row, angle, q)
    if kind == kinds.WALL:
        return a * c * max(0.0, c * (angle - b))
    if kind == kinds.SERIES:
        return now[int(a)]
    return min(max(motor, -a), a)  # dead zone: what is lost of a small torque


@compiled
def _periodic(row, angle, q):
    kind, a, b, c = row[0], row[3], row[4], row[5]
    if kind == kinds.RIPPLE:
        return a * _magnet(b * angle + c)
    if kind == kinds.COGGING_SUM:
        return a * np.cos(b * (angle + q[int(c)]))
    return a * np.sin(b * angle + c)


@compiled
def resist(table, q, motor_q, motor, now, channels):
    """Add up all explicit torques; write each into its channel.

    Args:
        table: Rows of torque. Shape (e, WIDTH).
        q: Angle of each link [rad]. Shape (dof,).
        motor_q: Angle of each motor [rad]. Shape (dof,).
        motor: Torque of each motor [N m]. Shape (dof,).
        now: Given torques of this time [N m]. Shape (s,).
        channels: Where to write, zero before [N m]. Shape (channels, dof).

    Returns:
        Torques at the link and at the motor [N m]. Shapes (dof,).
    """
    at_link, at_motor = np.zeros_like(q), np.zeros_like(q)
    for e in range(len(table)):
        row, joint = table[e], int(table[e, 1])
        inside = row[0] in kinds.AT_MOTOR
        angles = motor_q if inside else q
        torque = torque_of(row, angles[joint], angles, motor[joint], now)
        channels[int(row[2]), joint] += torque
        if inside:
            at_motor[joint] += torque
        else:
            at_link[joint] += torque
    return at_link, at_motor
