"""Samples that no arm can have made: spikes, leaps, values that stand or are coarse.

A joint that is held has an angle of one value too. It feels the others: its torque is
what the robot file, bent as far as a rough one may be, gives for a standing joint.
Torque beyond that is a moving joint's.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from residual.check.motion import Columns, Motion, columns, thin_rows
from residual.check.reported import shares_of, torque_factors
from residual.check.result import Fault, Repair, joints_of
from residual.check.rules import CHECK
from residual.errors import joints_listed
from residual.recording import Array, Recording
from residual.robot.robot import Robot

_NOTHING = 1e-12


def spikes(recording: Recording) -> list[Fault]:
    """Find single samples that leave their neighbours by far, and come back."""
    out = []
    for name in ("q", "qd", "tau"):
        signal = getattr(recording, name)
        if signal is None or len(signal) < 10:
            continue
        for j, column in enumerate(signal.T):
            at, size, usual = _single(column)
            if len(at):
                near = recording.t[int(at[len(at) // 2])]
                words = (
                    f"{name}{j + 1} leaves its neighbours for single samples, as near "
                    f"t = {near:.6g} s, by {size / max(usual, 1e-12):.3g} times what "
                    "its samples usually do."
                )
                out.append(_suspected("spike", recording, j, words))
    return out


def _suspected(kind: str, recording: Recording, j: int, words: str) -> Fault:
    return Fault(kind, (j + 1,), False, words, (), recording.id)


def wraps(recording: Recording, robot: Robot) -> list[Fault]:
    """Find angles that leap by a whole turn between two samples: an encoder that wraps.

    No joint of the robot can go so far in a step.
    """
    leap = np.diff(recording.q, axis=0)
    whole = np.abs(np.abs(leap) - 2 * np.pi) < CHECK.whole_turn
    far = 2 * np.pi - CHECK.whole_turn > CHECK.too_far * np.outer(
        np.diff(recording.t), robot.velocity_limit
    )
    # Of an angle in other units many steps are large, and of any size.
    large = np.abs(leap) > np.pi
    joints = joints_of((whole & far).any(axis=0) & (whole == large).all(axis=0))
    if not joints:
        return []
    words = (
        f"The angle of {joints_listed(joints)} leaps by a whole turn between two "
        "samples: the encoder begins again there."
    )
    repairs = (Repair("q", joints, unwrap=True),)
    return [Fault("out_of_range", joints, True, words, repairs, recording.id)]


def _single(x: Array) -> tuple[Array, float, float]:
    """Return the samples that stand out, by how much at most, and what is usual."""
    # Quarters: the difference of two huge values must not overflow.
    x = x / 4
    away = np.abs(x - running_median(x))
    steps = np.sort(np.abs(np.diff(x)))
    usual = max(np.sort(away)[int(0.99 * len(away))], steps[int(0.99 * len(steps))])
    high = away > CHECK.spike * max(usual, 1e-12)
    if not 0 < high.mean() <= CHECK.most_spikes + 3 / len(x):
        return np.array([], dtype=int), 0.0, float(usual)
    return np.flatnonzero(high), float(away.max()), float(usual)


def with_scale(recording: Recording, signal: str, scale: float) -> Recording:
    """Return a log with one of its signals, if it has that, times a factor."""
    values = getattr(recording, signal)
    if values is None:
        return recording
    return replace(recording, **{signal: np.asarray(values) * scale})


def without_spikes(recording: Recording) -> Recording:
    """Return a log smoothed by a running median, which no single sample survives."""
    signals = {name: getattr(recording, name) for name in ("q", "qd", "tau")}
    smooth = {k: running_median(x) for k, x in signals.items() if x is not None}
    return replace(recording, **smooth)


def running_median(x: Array) -> Array:
    """Return the median over each sample and its neighbours. (n,) or (n, dof)."""
    window = (CHECK.median_window,) + (1,) * (x.ndim - 1)
    return median_filter(x, window, mode="nearest")


def standing(recording: Recording) -> list[Fault]:
    """Find frozen, saturated and coarse signals of one log."""
    if len(recording.t) < 50:
        return []
    out = []
    for j in range(recording.dof):
        clipped = _clipped(recording.tau[:, j])
        if clipped:
            words = f"tau{j + 1} stands at {clipped} again and again: it is cut there."
            out.append(_suspected("saturated", recording, j, words))
        coarse = _coarse(recording, j)
        # Coarse values stand by themselves.
        if not clipped and not coarse:
            out += _frozen(recording, "tau", j, *_while_torque(recording, j))
        out += coarse or _frozen(recording, "q", j, *_while_angle(recording, j))
    return out


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
    least = max(CHECK.frozen_time / step, CHECK.frozen_samples)
    if lengths[k] < max(least, CHECK.usual_runs * usual):
        return None
    return slice(int(starts[k]), int(starts[k] + lengths[k]))


def _while_torque(recording: Recording, j: int) -> tuple[slice | None, str]:
    """Samples in which the torque stands, and what moves meanwhile; "" for nothing."""
    tau, q = recording.tau[:, j], recording.q[:, j]
    found = _longest(recording, tau)
    if np.ptp(tau) == 0 and np.ptp(q) > CHECK.moves:
        found = slice(0, len(recording.t))
    moves = found is not None and np.ptp(q[found]) >= CHECK.moves
    return found, "its joint moves" if moves else ""


def _while_angle(recording: Recording, j: int) -> tuple[slice | None, str]:
    q, wanted = recording.q[:, j], recording.q_ref
    found = _longest(recording, q)
    if found is None:
        return None, ""
    usual = float(np.quantile(np.abs(np.diff(q)), 0.99))
    jump = abs(q[min(found.stop, len(q) - 1)] - q[found.stop - 1])
    if wanted is not None and np.ptp(wanted[found, j]) > CHECK.moves:
        return found, "its reference moves"
    return found, "it then jumps" if jump > max(CHECK.jump, 3 * usual) else ""


def _frozen(
    recording: Recording, name: str, j: int, found: slice | None, moves: str
) -> list[Fault]:
    if found is None or not moves:
        return []
    first, last = recording.t[found.start], recording.t[found.stop - 1]
    words = (
        f"{name}{j + 1} stands still from t = {first:.6g} to {last:.6g} s, while "
        f"{moves}."
    )
    return [_suspected("frozen", recording, j, words)]


def _clipped(x: Array) -> str:
    """The limits at which a signal is cut, in words; "" for none."""
    starts, lengths = _runs(x)
    values, counts = np.unique(x, return_counts=True)
    if len(values) < 20:
        return ""
    limits = []
    for end, below in ((values[-1], counts[-6:-1]), (values[0], counts[1:6])):
        runs = lengths[x[starts] == end]
        often = np.sum(runs >= CHECK.clipped_run) >= CHECK.clipped_runs
        if often and runs.sum() > CHECK.fuller * below.max():
            limits.append(f"{end:.4g} N m")
    return " and ".join(limits)


def _coarse(recording: Recording, j: int) -> list[Fault]:
    out, rate = [], 1 / float(np.median(np.diff(recording.t)))
    tau, q = recording.tau[:, j], recording.q[:, j]
    step, size = _step(tau), float(np.std(tau))
    if step > CHECK.coarse_torque * max(size, 1e-12) and np.ptp(q) > CHECK.moves:
        words = (
            f"tau{j + 1} comes in steps of {step:.3g} N m, its rms is {size:.3g} N m."
        )
        out.append(_suspected("quantised", recording, j, words))
    step, cutoff = _step(q), CHECK.coarse_cutoff
    if step and np.ptp(q) > CHECK.moves:
        stride = max(1, round(rate / (2 * cutoff)))
        bend = np.diff(q[::stride], 2) * (rate / stride) ** 2
        # Noise of steps, evenly over their band, behind two derivatives.
        noise = step / np.sqrt(12) * np.sqrt(min(1.0, 2 * cutoff / rate))
        noise *= (2 * np.pi * cutoff) ** 2 / np.sqrt(5)
        if noise > CHECK.coarse_angle * float(np.sqrt(np.mean(bend**2))):
            words = (
                f"q{j + 1} comes in steps of {step:.3g} rad: at {cutoff:g} Hz that is "
                f"{noise:.3g} rad/s^2, as much as its acceleration."
            )
            out.append(_suspected("quantised", recording, j, words))
    return out


def _step(x: Array) -> float:
    """Step of a signal that comes in steps, else 0."""
    values = np.unique(x)
    if not 2 < len(values) < len(x) / 3:
        return 0.0
    gaps = np.diff(values)
    step = float(np.quantile(gaps, 0.1))
    whole = gaps / max(step, 1e-300)
    return step if np.mean(np.abs(whole - np.round(whole)) < 0.05) > 0.9 else 0.0


def constant(robot: Robot, recording: Recording) -> list[Fault]:
    """Find angles that keep one value while their torque is that of a moving joint."""
    span = np.ptp(recording.q, axis=0)
    still = np.flatnonzero(span == 0)
    if len(recording.t) < 50 or not len(still) or span.max() < CHECK.moves:
        return []
    said = {int(j): _moves_elsewhere(recording, j) for j in still}
    faults = [_unmoved(recording, j, why, True) for j, why in said.items() if why]
    motion, rest = thin_rows([recording]), [j for j, why in said.items() if not why]
    if motion is None or not rest:
        return faults
    if torque_factors(shares_of(robot, motion)) is not None:
        return faults  # in another unit a held joint's torque is any joint's
    motion = replace(motion, moving=np.ones_like(motion.moving))
    every = columns(robot, motion)
    parts = (_by_torque(recording, j, motion, every[j]) for j in rest)
    return faults + [fault for fault in parts if fault]


def _moves_elsewhere(recording: Recording, j: int) -> str:
    """Say where else the joint moves; "" if nowhere."""
    wanted, qd = recording.q_ref, recording.qd
    if wanted is not None and np.ptp(wanted[:, j]) > CHECK.moves:
        return f"its reference moves by {np.ptp(wanted[:, j]):.3g} rad"
    if qd is not None:
        steps = np.diff(recording.t) * (qd[1:, j] + qd[:-1, j]) / 2
        way = float(np.ptp(np.cumsum(steps)))
        smooth = np.std(np.diff(qd[:, j])) < 0.5 * np.std(qd[:, j])
        # What an offset and noise of a velocity add up to is no motion.
        if way > CHECK.moves + 3 * abs(float(steps.sum())) and smooth:
            return f"its velocity adds up to {way:.3g} rad"
    return ""


def _by_torque(
    recording: Recording, j: int, motion: Motion, own: Columns
) -> Fault | None:
    tau = motion.tau[:, j]
    size, left = float(np.std(tau)), _left(motion, tau, own)
    steps = np.abs(np.diff(recording.tau[:, j]))
    noise = float(np.median(steps)) / 0.6745 / np.sqrt(2)
    feels = float(np.sqrt(np.var(own.nominal) + np.var(own.values, axis=0).sum()))
    if left < max(CHECK.held_noise * noise, _NOTHING):
        return None
    if left < CHECK.held_left * size and left < CHECK.held_beyond * feels:
        return None
    why = (
        f"its torque moves by {np.ptp(tau):.3g} N m, {left:.3g} N m rms beside "
        f"all that a held joint feels of the others' motion (about {feels:.3g} N m)"
    )
    most, far = CHECK.held_most_left * size, CHECK.held_far_beyond * feels
    certain = left > most and left > far
    return _unmoved(recording, j, why, certain)


def _left(motion: Motion, tau: Array, own: Columns) -> float:
    """What a held joint's torque has beside a bent robot file."""
    y, a = tau - own.nominal, own.values
    sigma = max(CHECK.rough_start * float(np.std(tau)), _NOTHING)
    left = y
    for _ in range(CHECK.fit_rounds):
        weight = motion.spread / sigma**2
        at = np.linalg.solve(np.eye(a.shape[1]) + weight * a.T @ a, weight * a.T @ y)
        left = y - a @ at
        sigma = max(float(np.std(left)), _NOTHING)
    return float(np.std(left))


def _unmoved(recording: Recording, j: int, why: str, certain: bool) -> Fault:
    words = (
        f"q{j + 1} is {recording.q[0, j]:.6g} rad in all {len(recording.t)} samples, "
        f"bit for bit, while {why}: expected an angle that moves with it. Map the "
        "column in which it is logged (columns of q in --map), or record it."
    )
    return Fault("constant", (j + 1,), certain, words, (), recording.id)
