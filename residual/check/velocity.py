"""Whether the logged velocity is the derivative of the logged angle.

Over windows of a fifth of a second the angle must change by the integral of the
velocity: no derivative of a noisy signal is taken.
"""

from collections.abc import Sequence

import numpy as np

from residual.check.assignment import best_order
from residual.check.result import Fault, Repair
from residual.check.rules import CHECK
from residual.names import listed
from residual.recording import Array, Recording

# Velocity over change of the angle: which signal is in which unit.
_UNITS = {
    180 / np.pi: ("qd", "the velocities are in deg/s"),
    30 / np.pi: ("qd", "the velocities are in turns per minute"),
    1 / (2 * np.pi): ("qd", "the velocities are in turns per second"),
    np.pi / 180: ("q", "the angles are in degrees"),
}


def velocity_faults(recordings: Sequence[Recording]) -> list[Fault]:
    """Compare velocities with angles, all logs together."""
    logs = [r for r in recordings if r.qd is not None and len(r.t) > 20]
    pairs = [_windows(r) for r in logs]
    if not pairs or sum(len(change) for change, _ in pairs) < 10:
        return []
    change, integral = (np.concatenate(side) for side in zip(*pairs, strict=True))
    power = np.sqrt(np.sum(change**2, axis=0)), np.sqrt(np.sum(integral**2, axis=0))
    if power[0].max() == 0:
        return []
    moved = (power[0] > 0.01 * power[0].max()) & (power[1] > 0)
    norm = np.maximum(np.outer(*power), 1e-300)
    related = (change.T @ integral) / norm
    related[~moved] = 0.0
    order, swapped = _order(related, moved)
    slopes = _slopes(change, integral[:, order], related[:, order], moved)
    return swapped + slopes


def _windows(recording: Recording) -> tuple[Array, Array]:
    """Change of the angle, and integral of the velocity, window by window."""
    t, q = recording.t, recording.q
    step = float(np.median(np.diff(t)))
    stride = min(max(1, round(CHECK.velocity_window / step)), max(1, len(t) // 20))
    mean = (recording.qd[1:] + recording.qd[:-1]) / 2
    travelled = np.cumsum(mean * np.diff(t)[:, None], axis=0)
    travelled = np.concatenate([np.zeros((1, q.shape[1])), travelled])
    late = np.diff(t[::stride]) > 1.5 * stride * step
    parts = (np.diff(x[::stride], axis=0)[~late] for x in (q, travelled))
    return tuple(parts)


def _order(related: Array, moved: Array) -> tuple[Array, list[Fault]]:
    """Velocities of other joints: each angle finds its own among them."""
    own = np.diag(related)
    sure = np.abs(related) + 0.2 * np.eye(len(own))
    order = best_order(sure)
    joints = tuple(j + 1 for j, i in enumerate(order) if i != j)
    best = np.abs(related[np.arange(len(own)), order])
    if not joints or any(
        best[j - 1] < CHECK.velocity_same for j in joints if moved[j - 1]
    ):
        return np.arange(len(own)), []
    words = (
        f"The velocities of joints {listed(joints)} follow the angles of other joints "
        f"(correlation with their own at most "
        f"{max(abs(own[j - 1]) for j in joints):.2f}, in the order "
        f"{listed(order + 1)} at least {min(best[j - 1] for j in joints):.2f})."
    )
    repair = Repair("qd", order=tuple(int(i) + 1 for i in order))
    return order, [Fault("velocity_mismatch", joints, True, words, (repair,))]


def _slopes(
    change: Array, integral: Array, related: Array, moved: Array
) -> list[Fault]:
    own = np.diag(related)
    slope = np.sum(change * integral, axis=0) / np.maximum(
        np.sum(change**2, axis=0), 1e-300
    )
    good = moved & (np.abs(own) > CHECK.velocity_same)
    off = good & (np.abs(slope - 1) > CHECK.velocity_off)
    out = []
    if off.any() and good.sum() == off.sum() and good.sum() >= 2:
        size = float(np.median(np.abs(slope[good])))
        if np.all(np.abs(np.abs(slope[good]) / size - 1) < CHECK.velocity_alike):
            out += _common(size)
            slope = slope / (size if out else 1.0)
            off = good & (np.abs(slope - 1) > CHECK.velocity_off)
    out += _single(slope, off)
    loose = tuple(int(j) + 1 for j in np.flatnonzero(moved & ~good))
    if loose:
        words = (
            f"The velocity of joints {listed(loose)} is not the derivative of the "
            f"angle (correlation {min(abs(own[j - 1]) for j in loose):.2f}): filtered, "
            "late, or of something else."
        )
        out.append(Fault("velocity_mismatch", loose, False, words))
    return out


def _common(size: float) -> list[Fault]:
    """One factor between all velocities and angles: a unit, else the clock."""
    if abs(size - 1) < CHECK.velocity_off:
        return []
    for unit, (signal, name) in _UNITS.items():
        if abs(size / unit - 1) < CHECK.velocity_alike:
            words = f"All velocities are {size:.4g} times what the angles do: {name}."
            scale = 1 / unit if signal == "qd" else unit
            repair = Repair(signal, scale=scale)
            return [Fault("angle_unit", (), True, words, (repair,))]
    scale = 1 / size
    near = float(f"{scale:.1g}")
    scale = near if abs(scale / near - 1) < CHECK.velocity_alike else scale
    words = (
        f"All velocities are {size:.4g} times what the angles do in the time that is "
        f"given: time runs {size:.4g} times too slowly in this log."
    )
    return [Fault("time_unit", (), True, words, (Repair("t", scale=scale),))]


def _single(slope: Array, off: Array) -> list[Fault]:
    out = []
    negated = tuple(
        int(j) + 1 for j in np.flatnonzero(off & (abs(slope + 1) < CHECK.velocity_off))
    )
    if negated:
        words = f"The velocity of joints {listed(negated)} runs against the angle."
        repair = Repair("qd", negated, sign=(-1,) * len(negated))
        out.append(Fault("velocity_mismatch", negated, True, words, (repair,)))
    scaled = tuple(int(j) + 1 for j in np.flatnonzero(off) if int(j) + 1 not in negated)
    if scaled:
        sizes = [float(slope[j - 1]) for j in scaled]
        words = (
            f"The velocity of joints {listed(scaled)} is "
            f"{listed([f'{s:.4g}' for s in sizes])} times what the angle does."
        )
        repair = Repair("qd", scaled, scale=tuple(1 / s for s in sizes))
        out.append(Fault("velocity_mismatch", scaled, True, words, (repair,)))
    return out
