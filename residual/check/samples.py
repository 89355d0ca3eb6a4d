"""Samples that no arm can have made, and logs without them, or in another unit."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from residual.check.motion import Columns, Motion, columns, thin_rows
from residual.check.reported import shares_of, torque_factors
from residual.check.result import Fault
from residual.check.rules import CHECK
from residual.names import joints_listed
from residual.recording import Array, Recording
from residual.robot.robot import Robot


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
                out.append(_spike(recording, f"{name}{j + 1}", (at, size, usual)))
    return out


def wraps(recording: Recording, robot: Robot) -> list[Fault]:
    """Find angles that leap by a whole turn between two samples: an encoder that wraps.

    Args:
        robot: The arm, for what its joints can do in a step.
    """
    leap = np.diff(recording.q, axis=0)
    whole = np.abs(np.abs(leap) - 2 * np.pi) < CHECK.whole_turn
    far = 2 * np.pi - CHECK.whole_turn > CHECK.too_far * np.outer(
        np.diff(recording.t), robot.velocity_limit
    )
    # Of an angle in other units many steps are large, and of any size.
    large = np.abs(leap) > np.pi
    found = (whole & far).any(axis=0) & (whole == large).all(axis=0)
    joints = tuple(int(j) + 1 for j in np.flatnonzero(found))
    if not joints:
        return []
    words = (
        f"The angle of {joints_listed(joints)} leaps by a whole turn between two "
        "samples: the encoder begins again there. Unwrap it before it is logged."
    )
    return [Fault("out_of_range", joints, True, words, (), recording.id)]


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


def _spike(recording: Recording, name: str, found: tuple[Array, float, float]) -> Fault:
    at, size, usual = found
    worst = int(at[len(at) // 2])
    words = (
        f"{name} leaves its neighbours for single samples, as near t = "
        f"{recording.t[worst]:.6g} s, by {size / max(usual, 1e-12):.3g} times what its "
        "samples usually do."
    )
    joint = int(name.lstrip("qdtau"))
    return Fault("spike", (joint,), False, words, (), recording.id)


def with_scale(recording: Recording, signal: str, scale: float) -> Recording:
    """Return a log with one of its signals times a factor.

    Args:
        signal: "t", "q", "qd", "tau" or "q_ref".
    """
    return replace(
        recording, **{signal: np.asarray(getattr(recording, signal)) * scale}
    )


def without_spikes(recording: Recording) -> Recording:
    """Return a log smoothed by a running median, which no single sample survives."""
    names = ("q", "qd", "tau")
    signals = {name: getattr(recording, name) for name in names}
    smooth = {k: running_median(x) for k, x in signals.items() if x is not None}
    return replace(recording, **smooth)


def running_median(x: Array) -> Array:
    """Return the median over each sample and its neighbours.

    Args:
        x: Samples along the first axis. Shape (n,) or (n, dof).
    """
    window = (CHECK.median_window,) + (1,) * (x.ndim - 1)
    return median_filter(x, window, mode="nearest")


_NOTHING = 1e-12


def standing(recording: Recording) -> list[Fault]:
    """Find frozen, saturated and coarse signals of one log."""
    if len(recording.t) < 50:
        return []
    out = []
    for j in range(recording.dof):
        clipped = _clipped(recording.tau[:, j])
        if clipped:
            words = f"tau{j + 1} stands at {clipped} again and again: it is cut there."
            out.append(Fault("saturated", (j + 1,), False, words, (), recording.id))
        coarse = _coarse(recording, j)
        # Coarse values stand by themselves.
        if not clipped and not coarse:
            out += _frozen_torque(recording, j)
        out += coarse or _frozen_angle(recording, j)
    return out


def _runs(x: Array) -> tuple[Array, Array]:
    """First sample and length of every run of equal values."""
    edges = np.flatnonzero(np.diff(x) != 0) + 1
    starts = np.concatenate([[0], edges])
    return starts, np.diff(np.concatenate([starts, [len(x)]]))


def _longest(recording: Recording, x: Array) -> tuple[int, int] | None:
    """The longest run, if it is long and unlike the others."""
    starts, lengths = _runs(x)
    if len(starts) < 2:
        return None
    k = int(np.argmax(lengths))
    step = float(np.median(np.diff(recording.t)))
    usual = float(np.quantile(np.delete(lengths, k), 0.95))
    if lengths[k] < max(
        CHECK.frozen_time / step, CHECK.frozen_samples, CHECK.usual_runs * usual
    ):
        return None
    return int(starts[k]), int(starts[k] + lengths[k])


def _frozen_torque(recording: Recording, j: int) -> list[Fault]:
    found = _longest(recording, recording.tau[:, j])
    if np.ptp(recording.tau[:, j]) == 0 and np.ptp(recording.q[:, j]) > CHECK.moves:
        found = (0, len(recording.t))
    if found is None:
        return []
    a, b = found
    if np.ptp(recording.q[a:b, j]) < CHECK.moves:
        return []
    return [_frozen(recording, f"tau{j + 1}", found, "its joint moves")]


def _frozen_angle(recording: Recording, j: int) -> list[Fault]:
    found = _longest(recording, recording.q[:, j])
    if found is None:
        return []
    (a, b), q = found, recording.q[:, j]
    usual = float(np.quantile(np.abs(np.diff(q)), 0.99))
    jump = abs(q[min(b, len(q) - 1)] - q[b - 1])
    wanted = recording.q_ref
    if wanted is not None and np.ptp(wanted[a:b, j]) > CHECK.moves:
        return [_frozen(recording, f"q{j + 1}", found, "its reference moves")]
    if jump > max(CHECK.jump, 3 * usual):
        return [_frozen(recording, f"q{j + 1}", found, "it then jumps")]
    return []


def _frozen(recording: Recording, name: str, found: tuple[int, int], why: str) -> Fault:
    first, last = recording.t[found[0]], recording.t[found[1] - 1]
    words = f"{name} stands still from t = {first:.6g} to {last:.6g} s, while {why}."
    return Fault("frozen", (int(name.lstrip("qtau")),), False, words, (), recording.id)


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
        out.append(Fault("quantised", (j + 1,), False, words, (), recording.id))
    step = _step(q)
    if step and np.ptp(q) > CHECK.moves:
        stride = max(1, round(rate / (2 * CHECK.coarse_cutoff)))
        bend = np.diff(q[::stride], 2) * (rate / stride) ** 2
        noise = step / np.sqrt(12) * np.sqrt(min(1.0, 2 * CHECK.coarse_cutoff / rate))
        noise *= (2 * np.pi * CHECK.coarse_cutoff) ** 2 / np.sqrt(5)
        if noise > CHECK.coarse_angle * float(np.sqrt(np.mean(bend**2))):
            words = (
                f"q{j + 1} comes in steps of {step:.3g} rad: at "
                f"{CHECK.coarse_cutoff:g} Hz that is {noise:.3g} rad/s^2, as much as "
                "its acceleration."
            )
            out.append(Fault("quantised", (j + 1,), False, words, (), recording.id))
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
    faults = [_fault(recording, j, why, True) for j, why in said.items() if why]
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
        # What an offset and noise of a velocity add up to is no motion.
        if way > CHECK.moves + 3 * abs(float(steps.sum())) and _turns(qd[:, j]):
            return f"its velocity adds up to {way:.3g} rad"
    return ""


def _turns(qd: Array) -> bool:
    """Whether a velocity is smooth beside its size: its steps are those of a motion."""
    return bool(np.std(np.diff(qd)) < 0.5 * np.std(qd))


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
    certain = (
        left > CHECK.held_most_left * size and left > CHECK.held_far_beyond * feels
    )
    return _fault(recording, j, why, certain)


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


def _fault(recording: Recording, j: int, why: str, certain: bool) -> Fault:
    words = (
        f"q{j + 1} is {recording.q[0, j]:.6g} rad in all {len(recording.t)} samples, "
        f"bit for bit, while {why}: expected an angle that moves with it. Map the "
        "column in which it is logged (columns of q in --map), or record it."
    )
    return Fault("constant", (j + 1,), certain, words, (), recording.id)
