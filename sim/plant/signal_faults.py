"""Signals that lie: encoders that the controller believes, torque constants."""

from collections.abc import Sequence

import numpy as np

from sim.catalogue import Acting
from sim.plant import tables as at
from sim.plant.compiled import compiled

Array = np.ndarray

FAST, FAR = 60.0, 1.0  # rad/s, rad: beyond them a real arm has been stopped


def encoder_errors(effects: Sequence[Acting], dof: int) -> Array:
    """Return constant, cosine and sine of the error, true minus reading [rad].

    Args:
        effects: Those that act.
        dof: Number of joints.

    Returns:
        The three coefficients of each joint. Shape (3, dof).
    """
    errors = np.zeros((3, dof))
    for what, p, joints, _ in effects:
        if what.encoder:
            errors[:, list(joints)] += np.reshape(what.encoder(p), (3, 1))
    return errors


def torque_constants(effects: Sequence[Acting], dof: int) -> Array:
    """Return real over reported torque of each joint. Shape (dof,)."""
    ratio = np.ones(dof)
    for what, p, joints, _ in effects:
        if what.gain:
            ratio[list(joints)] /= 1.0 + what.gain(p)
    return ratio


@compiled
def read(k, joints, motors, goal, trace):
    """Read the encoders, which sit on the motors, and watch over the arm.

    reading = x - shift - cos cos x - sin sin x, with x the true angle of the motor.

    Args:
        k: Number of the step.
        joints: Constants of the joints, packed.
        motors: Of the state; those of rigid joints are set to their link.
        goal: Position that is asked for [rad]. Shape (dof,).
        trace: Rows Q and QD are read; motors and readings are written.

    Returns:
        The joint, from 1, that has run away farthest; 0 if none has.
    """
    now, astray, farthest = trace[k], 0, 1.0
    elastic, shift, cos, sin = joints[1], joints[8], joints[9], joints[10]
    for j in range(len(elastic)):
        if elastic[j] == 0:
            motors[at.ANGLE, j], motors[at.SPEED, j] = now[at.Q, j], now[at.QD, j]
        x, speed = motors[at.ANGLE, j], motors[at.SPEED, j]
        now[at.MOTOR_Q, j], now[at.MOTOR_QD, j] = x, speed
        wave = cos[j] * np.cos(x) + sin[j] * np.sin(x)
        slope = sin[j] * np.cos(x) - cos[j] * np.sin(x)
        now[at.READING, j] = x - shift[j] - wave
        now[at.READING_RATE, j] = speed * (1.0 - slope)
        off = abs(now[at.READING, j] - goal[j]) / FAR
        off = max(abs(now[at.QD, j]) / FAST, off)
        if np.isnan(off):
            off = np.inf
        if off > farthest:
            astray, farthest = j + 1, off
    return astray


def true_angle(reading: Array, errors: Array) -> Array:
    """Return the motor angles at which the encoders read that [rad]. Shape (dof,)."""
    shift, cos, sin = errors
    x = reading + shift
    for _ in range(20):  # contracts by the size of the error each time
        x = reading + shift + cos * np.cos(x) + sin * np.sin(x)
    return x
