"""Impossible samples: spikes, jumps, constant or coarse values.

A joint that is held also has a constant angle. It reacts to the others: its torque is
that of a standing joint by a rough robot file. Torque beyond that shows a moving joint.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from residual.check.evidence import (
    build_prior_columns,
    filter_check_motion,
    fit_nominal_shares,
    sum_arm,
)
from residual.check.result import Fault, Repair, list_true_joints
from residual.check.slips import list_factor_slips
from residual.check.thresholds import CHECK
from residual.errors import format_joint_numbers
from residual.recording import Array, Recording
from residual.robot.robot import Robot

_NOTHING = 1e-12
_WINDOW = 7  # samples of the running median
_TURN = 0.3  # rad off a whole turn: motion of the joint within a step


def find_spikes(recording: Recording) -> list[Fault]:
    """Find single samples far from both neighbours."""
    out = []
    for name in ("q", "qd", "tau"):
        signal = getattr(recording, name)
        if signal is None or len(signal) < 10:
            continue
        signal = signal / 4  # the difference of two must not overflow
        # Typical motion of the joints: a held one shows single bits of its sensor.
        largest = float(np.max(np.quantile(np.abs(signal), 0.99, axis=0)))
        for j, x in enumerate(signal.T):
            away = np.abs(x - compute_running_median(x))
            # Relative to the 99 % quantile of the deviations: noise stays below.
            usual = np.quantile(away, 0.99, method="lower")
            usual = max(usual, np.quantile(np.abs(np.diff(x)), 0.99), 1e-12)
            high = away > max(CHECK.spike_ratio * usual, CHECK.outlier_share * largest)
            if high.any() and (bit := find_least_step(x)) < CHECK.bit_share * largest:
                usual = max(usual, bit)
                high &= away > CHECK.spike_ratio * usual
            if 0 < high.mean() <= CHECK.spike_share + 3 / len(x):
                at = np.flatnonzero(high)
                near = recording.t[at[len(at) // 2]]
                words = f"Isolated outlier in {name}{j + 1} near t = {near:.6g} s "
                words += f"({away.max() / usual:.3g} times the usual deviation)."
                out.append(_suspected("spike", recording, j, words))
    return out


def find_least_step(x: Array) -> float:
    """Return the least distance of two values of a signal; 0 for a single value."""
    steps = np.diff(np.unique(x))
    return float(steps.min()) if len(steps) else 0.0


def _suspected(kind: str, recording: Recording, j: int, words: str) -> Fault:
    return Fault(kind, (j + 1,), False, words, (), recording.id)


def find_encoder_wraps(recording: Recording, robot: Robot) -> list[Fault]:
    """Find angles that jump by a whole turn between two samples: an encoder that wraps.

    No joint of the robot can move so far in a step.
    """
    leap = np.diff(recording.q, axis=0)
    whole = np.abs(np.abs(leap) - 2 * np.pi) < _TURN
    far = 2 * np.pi - _TURN > 10 * np.outer(np.diff(recording.t), robot.velocity_limit)
    # An angle in other units has many large steps, of any size.
    large = np.abs(leap) > np.pi
    joints = list_true_joints((whole & far).any(axis=0) & (whole == large).all(axis=0))
    if not joints:
        return []
    words = f"The angle of {format_joint_numbers(joints)} jumps by 2*pi between two samples: "
    words += "the encoder wraps."
    repairs = (Repair("q", joints, unwrap=True),)
    return [Fault("out_of_range", joints, True, words, repairs, recording.id)]


def scale_signal(recording: Recording, signal: str, scale: float) -> Recording:
    """Return a log with one of its signals scaled, if present."""
    values = getattr(recording, signal)
    if values is None:
        return recording
    return replace(recording, **{signal: np.asarray(values) * scale})


def smooth_spikes(recording: Recording) -> Recording:
    """Return a log smoothed by a running median, which removes single samples."""
    signals = {name: getattr(recording, name) for name in ("q", "qd", "tau")}
    smooth = {k: compute_running_median(x) for k, x in signals.items() if x is not None}
    return replace(recording, **smooth)


def compute_running_median(x: Array) -> Array:
    """Return the median over each sample and its neighbours. (n,) or (n, dof)."""
    window = (_WINDOW,) + (1,) * (x.ndim - 1)
    return median_filter(x, window, mode="nearest")


def find_frozen_signals(recording: Recording) -> list[Fault]:
    """Find frozen, saturated and coarse signals of one log."""
    if len(recording.t) < 50:
        return []
    # The distance from a drive's goal to its position is its torque.
    driven = recording.drive is not None
    out, reference = [], None if driven else recording.q_ref
    for j in range(recording.dof):
        tau, q = recording.tau[:, j], recording.q[:, j]
        clipped = "" if driven else _clipped(tau)
        if clipped:
            words = f"tau{j + 1} repeatedly stays at {clipped}: it saturates there."
            out.append(_suspected("saturated", recording, j, words))
        coarse = _coarse(recording, j)
        out += coarse
        run = None if driven else _longest(recording, tau)
        if np.ptp(tau) == 0 and np.ptp(q) > CHECK.moving_rad:
            run = slice(0, len(tau))
        # Coarse values are an independent fault.
        if run and not clipped and not coarse and np.ptp(q[run]) >= CHECK.moving_rad:
            out.append(_frozen(recording, "tau", j, run, "its joint moves"))
        run = _longest(recording, q)
        if run and not coarse:
            usual = float(np.quantile(np.abs(np.diff(q)), 0.99))
            jump = abs(q[min(run.stop, len(q) - 1)] - q[run.stop - 1])
            if reference is not None and np.ptp(reference[run, j]) > CHECK.moving_rad:
                out.append(_frozen(recording, "q", j, run, "its reference moves"))
            elif jump > max(CHECK.moving_rad, 3 * usual):
                out.append(_frozen(recording, "q", j, run, "it then jumps"))
    return out


def _frozen(recording: Recording, name: str, j: int, run: slice, moves: str) -> Fault:
    first, last = recording.t[run.start], recording.t[run.stop - 1]
    words = f"{name}{j + 1} is constant from t = {first:.6g} to {last:.6g} s, while {moves}."
    return _suspected("frozen", recording, j, words)


def _runs(x: Array) -> tuple[Array, Array]:
    """First sample and length of every run of equal values."""
    edges = np.flatnonzero(np.diff(x) != 0) + 1
    starts = np.concatenate([[0], edges])
    return starts, np.diff(np.concatenate([starts, [len(x)]]))


def _longest(recording: Recording, x: Array) -> slice | None:
    """The longest run, if it is long and unlike the others."""
    starts, lengths = _runs(x)
    if len(starts) < 2:
        return None
    k = int(np.argmax(lengths))
    step = float(np.median(np.diff(recording.t)))
    usual = float(np.quantile(np.delete(lengths, k), 0.95))
    least = max(CHECK.frozen_s / step, 15)
    if lengths[k] < max(least, 5 * usual):
        return None
    return slice(int(starts[k]), int(starts[k] + lengths[k]))


def _clipped(x: Array) -> str:
    """The limits at which a signal is cut, in words; "" for none."""
    starts, lengths = _runs(x)
    values, counts = np.unique(x, return_counts=True)
    if len(values) < 20:
        return ""
    limits = []
    for end, below in ((values[-1], counts[-6:-1]), (values[0], counts[1:6])):
        runs = lengths[x[starts] == end]
        often = np.sum(runs >= 4) >= 2
        if often and runs.sum() > 4 * below.max():
            limits.append(f"{end:.4g} N m")
    return " and ".join(limits)


def _coarse(recording: Recording, j: int) -> list[Fault]:
    out, rate = [], 1 / float(np.median(np.diff(recording.t)))
    tau, q = recording.tau[:, j], recording.q[:, j]
    step, size = _step(tau), float(np.std(tau))
    if step > CHECK.torque_step_ratio * max(size, 1e-12) and np.ptp(q) > CHECK.moving_rad:
        words = f"tau{j + 1} comes in steps of {step:.3g} N m, its rms is {size:.3g} N m."
        out.append(_suspected("quantised", recording, j, words))
    step, cutoff = _step(q), 12.0
    if step and np.ptp(q) > CHECK.moving_rad:
        stride = max(1, round(rate / (2 * cutoff)))
        bend = np.diff(q[::stride], 2) * (rate / stride) ** 2
        # Noise of steps, uniform over their band, after two derivatives.
        noise = step / np.sqrt(12) * np.sqrt(min(1.0, 2 * cutoff / rate))
        noise *= (2 * np.pi * cutoff) ** 2 / np.sqrt(5)
        if noise > CHECK.angle_step_ratio * float(np.sqrt(np.mean(bend**2))):
            words = f"q{j + 1} comes in steps of {step:.3g} rad: at {cutoff:g} Hz that is "
            words += f"{noise:.3g} rad/s^2, as much as its acceleration."
            out.append(_suspected("quantised", recording, j, words))
    return out


def _step(x: Array) -> float:
    """Step of a quantized signal, else 0."""
    values = np.unique(x)
    if not 2 < len(values) < len(x) / 3:
        return 0.0
    gaps = np.diff(values)
    step = float(np.quantile(gaps, 0.1))
    whole = gaps / max(step, 1e-300)
    return step if np.mean(np.abs(whole - np.round(whole)) < 0.05) > 0.9 else 0.0


def find_constant_angles(robot: Robot, recording: Recording) -> list[Fault]:
    """Find angles that keep one value while their torque is that of a moving joint."""
    span = np.ptp(recording.q, axis=0)
    still = np.flatnonzero(span == 0)
    if len(recording.t) < 50 or not len(still) or span.max() < CHECK.moving_rad:
        return []
    # If one joint moves, the others are held on purpose.
    jointwise = np.sum(span > CHECK.moving_rad) == 1
    out, silent = [], []
    for j in map(int, still):
        if why := _moves_elsewhere(recording, j):
            out.append(_unmoved(recording, j, why, True))
        else:
            silent.append(j)
    if jointwise and recording.dof > 2:
        return out
    motion = filter_check_motion([recording]) if silent else None
    if motion is None:
        return out
    shares = fit_nominal_shares(sum_arm(robot, motion), np.arange(robot.dof))
    if list_factor_slips(robot, shares):
        return out  # in a wrong unit the torque of a held joint is not recognizable
    motion = replace(motion, moving=np.ones_like(motion.moving))
    every = build_prior_columns(robot, motion)
    for j in silent:
        tau, nominal, values = motion.tau[:, j], every[j].nominal, every[j].values
        size, residual = (float(np.std(tau)), _residual_rms(motion.spread, tau - nominal, values))
        noise = float(np.median(np.abs(np.diff(recording.tau[:, j])))) / 0.95
        noise = max(noise, find_least_step(recording.tau[:, j]))
        feels = float(np.sqrt(np.var(nominal) + np.var(values, axis=0).sum()))
        # Other friction and a load leave up to half of it unexplained; static friction, more.
        if residual < 5 * noise or residual < min(0.5 * size, 2 * feels):
            continue
        why = (
            f"its torque moves by {np.ptp(tau):.3g} N m, {residual:.3g} N m rms beside "
            f"all that a held joint feels of the others' motion (about {feels:.3g} N m)"
        )
        certain = residual > CHECK.held_residual_share * size and residual > 2 * feels
        if certain or not jointwise:
            out.append(_unmoved(recording, j, why, certain))
    return out


def _moves_elsewhere(recording: Recording, j: int) -> str:
    """Return where else the joint moves, in words; "" if nowhere."""
    reference, qd = recording.q_ref, recording.qd
    if reference is not None and np.ptp(reference[:, j]) > CHECK.moving_rad:
        return f"its reference moves by {np.ptp(reference[:, j]):.3g} rad"
    if qd is not None:
        steps = np.diff(recording.t) * (qd[1:, j] + qd[:-1, j]) / 2
        way = float(np.ptp(np.cumsum(steps)))
        smooth = np.std(np.diff(qd[:, j])) < 0.5 * np.std(qd[:, j])
        # The integral of offset and noise of a velocity is no motion.
        if way > CHECK.moving_rad + 3 * abs(float(steps.sum())) and smooth:
            return f"its velocity adds up to {way:.3g} rad"
    return ""


def _residual_rms(spread: float, y: Array, a: Array) -> float:
    """Residual torque of a held joint under a rough robot file [N m rms]."""
    residual, sigma = y, max(0.05 * float(np.std(y)), _NOTHING)
    for _ in range(4):
        weight = spread / sigma**2
        at = np.linalg.solve(np.eye(a.shape[1]) + weight * a.T @ a, weight * a.T @ y)
        residual = y - a @ at
        sigma = max(float(np.std(residual)), _NOTHING)
    return float(np.std(residual))


def _unmoved(recording: Recording, j: int, why: str, certain: bool) -> Fault:
    words = (
        f"q{j + 1} is {recording.q[0, j]:.6g} rad in all {len(recording.t)} samples, "
        f"bit for bit, while {why}: expected an angle that moves with it. Map the "
        "column in which it is logged (columns of q in --map), or record it."
    )
    return Fault("constant", (j + 1,), certain, words, (), recording.id)
