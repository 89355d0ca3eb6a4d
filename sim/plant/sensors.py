"""Readings of sensors, and faulty signals.

The controller uses the readings of a faulty encoder, and a wrong torque constant.
The code for frozen or drifting encoders does not change the bits of other arms.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from residual.recording import Array
from sim.effects.base import PlantEffectTrait
from sim.plant import step_tables as at
from sim.plant.effect_catalogue import ActingEffect
from sim.plant.step_tables import compile_lazily

ENCODER_STEP = 1e-4  # rad
WHITE_TORQUE = 0.015  # of the torque range
SLOW_TORQUE = 0.005  # of the torque range
SLOW_TIME = 0.1  # s
SLACK = 1e-9  # s: an onset on a sample acts on that sample
FAST, FAR = 60.0, 1.0  # rad/s, rad: beyond them a real arm has been stopped


def simulate_encoder(q: Array, rng: np.random.Generator, step: float = ENCODER_STEP) -> Array:
    """Return positions with noise of half a step, rounded to whole steps [rad]."""
    noisy = q + step / 2 * rng.normal(size=q.shape)
    return np.round(noisy / step) * step


def draw_torque_noise(samples: int, span: Array, rate: float, rng: np.random.Generator) -> Array:
    """Return the noise of the torque sensors: white, and a slow AR(1) process.

    n_i = span (0.015 w_i + 0.005 x_i), x_i = a x_(i-1) + sqrt(1 - a^2) v_i,
    a = exp(-1 / (0.1 s rate))
    """
    from scipy.signal import lfilter

    a = np.exp(-1.0 / (SLOW_TIME * rate))
    white, drive = rng.normal(size=(2, samples, len(span)))
    before = a * rng.normal(size=(1, len(span)))
    slow, _ = lfilter([np.sqrt(1 - a * a)], [1, -a], drive, axis=0, zi=before)
    return span * (WHITE_TORQUE * white + SLOW_TORQUE * slow)


def simulate_torque_report(tau: Array, t: Array, effects: Sequence[ActingEffect]) -> Array:
    """Return the torque as it is reported, noise apart [N m]. Shape (n, dof).

    The drive itself works; its report ends at the range of its sensor, then it comes
    late, then the sensor is broken.

    Args:
        tau: Torque that the drives are commanded to give [N m]. Shape (n, dof).
        effects: All effects; each acts from its onset on.
    """
    out = tau.copy()

    def order(effect: ActingEffect) -> tuple[bool, bool]:
        """Return the key of the order: drives, effects of all joints, broken sensors."""
        return (PlantEffectTrait.SENSOR in effect.kind.traits, effect.kind.scope == "global")

    for kind, p, joints, onset in sorted(effects, key=order):
        if kind.report:
            rows = list(joints) or list(range(out.shape[1]))
            acts = np.ix_(t >= onset - SLACK, rows)
            out[acts] = kind.report(out[:, rows], t, onset, p)[acts[0][:, 0]]
    return out


def sum_encoder_errors(effects: Sequence[ActingEffect], dof: int) -> Array:
    """Return constant, cosine and sine of the error, true minus reading [rad]."""
    errors = np.zeros((3, dof))
    for kind, p, joints, _ in effects:
        if kind.encoder:
            errors[:, list(joints)] += np.reshape(kind.encoder(p), (3, 1))
    return errors


def compute_torque_ratios(effects: Sequence[ActingEffect], dof: int) -> Array:
    """Return real over reported torque of each joint. Shape (dof,)."""
    ratio = np.ones(dof)
    for kind, p, joints, _ in effects:
        if kind.gain:
            ratio[list(joints)] /= 1.0 + kind.gain(p)
    return ratio


@compile_lazily
def read_encoders(k, joints, motors, goal, trace):
    """Read the encoders, which sit on the motors, and watch over the arm.

    reading = x - shift - cos cos x - sin sin x, with x the true angle of the motor.

    Args:
        motors: Of the state; those of rigid joints are set to their link.
        goal: Position of the reference [rad]. Shape (dof,).
        trace: Rows Q and QD are read; motors and readings are written.

    Returns:
        The joint, from 1, that has run away farthest; 0 if none has.
    """
    now, astray, farthest = trace[k], 0, 1.0
    elastic, shift, cos, sin = joints[at.ELASTIC], joints[at.SHIFT], joints[at.COS], joints[at.SIN]
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


def invert_encoder_error(reading: Array, errors: Array) -> Array:
    """Return the motor angles for given readings of the encoders [rad]. Shape (dof,)."""
    shift, cos, sin = errors
    x = reading + shift
    for _ in range(20):  # contracts by the size of the error each time
        x = reading + shift + cos * np.cos(x) + sin * np.sin(x)
    return x


class EncoderFaults(NamedTuple):
    """Encoders that are faulty from a step on."""

    # Joint from 0 and first step of each frozen encoder.
    frozen: tuple[tuple[int, int], ...]
    # Joint from 0, first step and rate [rad/s] of each drifting encoder.
    drift: tuple[tuple[int, int, float], ...]

    def read(self, k: int, dt: float, rows: Array) -> None:
        """Change the readings of the controller on step k; rows are the trace so far."""
        now = rows[k]
        for joint, first, rate in self.drift:
            now[at.READING, joint] -= rate * (k - first) * dt
            now[at.READING_RATE, joint] -= rate
        for joint, first in self.frozen:
            now[at.READING, joint] = rows[max(first - 1, 0), at.READING, joint]
            now[at.READING_RATE, joint] = 0.0


def collect_encoder_faults(effects: Sequence[ActingEffect], dt: float) -> EncoderFaults | None:
    """Return the encoder faults among the effects that act, None if there are none."""
    frozen, drift = [], []
    for kind, p, joints, onset in effects:
        first = int(np.ceil(onset / dt - 1e-6))
        if PlantEffectTrait.FROZEN in kind.traits:
            frozen += [(joint, first) for joint in joints]
        if kind.drift:
            drift += [(joint, first, kind.drift(p)) for joint in joints]
    if not frozen and not drift:
        return None
    return EncoderFaults(tuple(frozen), tuple(drift))


def repeat_frozen_readings(q: Array, t: Array, effects: Sequence[ActingEffect]) -> Array:
    """Return the log of the encoders, where a frozen one repeats its last reading.

    The number itself is frozen, including the noise of the reading.
    """
    if not any(PlantEffectTrait.FROZEN in effect.kind.traits for effect in effects):
        return q
    out = q.copy()
    for kind, _, joints, onset in effects:
        if PlantEffectTrait.FROZEN in kind.traits:
            first, rows = int(np.searchsorted(t, onset - SLACK)), list(joints)
            out[first:, rows] = out[max(first - 1, 0), rows]
    return out
