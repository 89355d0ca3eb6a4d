"""Values that stand: frozen, clipped, or in steps that are too coarse."""

import numpy as np

from residual.check.result import Fault
from residual.recording import Array, Recording

_LONG = 0.3  # s that a frozen value lasts
_FEW = 15  # samples of it at least
_USUAL_RUNS = 5.0  # times the runs that a signal has elsewhere
_MOVES = 0.02  # rad that a joint moves while its torque stands
_JUMP = 0.01  # rad by which a frozen angle comes back
_CLIPPED_RUN, _CLIPPED_RUNS = 4, 2  # samples at the limit, and how often
_FULLER = 4.0  # times the samples of the levels below it
_COARSE_TORQUE = 0.08  # of the torque's rms
_COARSE_ANGLE = 0.4  # of the acceleration's rms
_CUTOFF = 12.0  # Hz at which accelerations are judged


def standing(recording: Recording) -> list[Fault]:
    """Find frozen, saturated and coarse signals of one log.

    Args:
        recording: The log.
    """
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
    if lengths[k] < max(_LONG / step, _FEW, _USUAL_RUNS * usual):
        return None
    return int(starts[k]), int(starts[k] + lengths[k])


def _frozen_torque(recording: Recording, j: int) -> list[Fault]:
    found = _longest(recording, recording.tau[:, j])
    if np.ptp(recording.tau[:, j]) == 0 and np.ptp(recording.q[:, j]) > _MOVES:
        found = (0, len(recording.t))
    if found is None:
        return []
    a, b = found
    if np.ptp(recording.q[a:b, j]) < _MOVES:
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
    if wanted is not None and np.ptp(wanted[a:b, j]) > _MOVES:
        return [_frozen(recording, f"q{j + 1}", found, "its reference moves")]
    if jump > max(_JUMP, 3 * usual):
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
        often = np.sum(runs >= _CLIPPED_RUN) >= _CLIPPED_RUNS
        if often and runs.sum() > _FULLER * below.max():
            limits.append(f"{end:.4g} N m")
    return " and ".join(limits)


def _coarse(recording: Recording, j: int) -> list[Fault]:
    out, rate = [], 1 / float(np.median(np.diff(recording.t)))
    tau, q = recording.tau[:, j], recording.q[:, j]
    step, size = _step(tau), float(np.std(tau))
    if step > _COARSE_TORQUE * max(size, 1e-12) and np.ptp(q) > _MOVES:
        words = (
            f"tau{j + 1} comes in steps of {step:.3g} N m, its rms is {size:.3g} N m."
        )
        out.append(Fault("quantised", (j + 1,), False, words, (), recording.id))
    step = _step(q)
    if step and np.ptp(q) > _MOVES:
        stride = max(1, round(rate / (2 * _CUTOFF)))
        bend = np.diff(q[::stride], 2) * (rate / stride) ** 2
        noise = step / np.sqrt(12) * np.sqrt(min(1.0, 2 * _CUTOFF / rate))
        noise *= (2 * np.pi * _CUTOFF) ** 2 / np.sqrt(5)
        if noise > _COARSE_ANGLE * float(np.sqrt(np.mean(bend**2))):
            words = (
                f"q{j + 1} comes in steps of {step:.3g} rad: at {_CUTOFF:g} Hz that is "
                f"{noise:.3g} rad/s^2, as much as its acceleration."
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
