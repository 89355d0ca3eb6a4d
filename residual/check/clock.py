"""Whether time is in seconds, and runs evenly."""

from collections.abc import Sequence

import numpy as np

from residual.check.result import Fault, Repair
from residual.recording import Array, Recording, usual_speed
from residual.robot.robot import Robot

_SLOWEST, _FASTEST = 4.0, 20_000.0  # samples per second that logs of arms have
_USUAL = 300.0
_UNITS = {
    1e-3: "milliseconds",
    1e-6: "microseconds",
    1e-9: "nanoseconds",
    1e3: "seconds that were taken for milliseconds",
    1e6: "seconds that were taken for microseconds",
}
_GAP = 5.0  # steps
_UNEVEN = 0.3  # of a step
_TOO_FAST = 20.0  # of a joint's speed limit
_SHARE = 0.95  # of the samples are slower


def time_unit(robot: Robot, recordings: Sequence[Recording]) -> Fault | None:
    """Find a time that no logger keeps, and the unit in which one would."""
    logs = [r for r in recordings if len(r.t) > 2]
    if not logs:
        return None
    rate = float(np.median([1 / np.median(np.diff(r.t)) for r in logs]))
    speed = float(max(np.max(_speed(r) / robot.velocity_limit) for r in logs))
    if _SLOWEST <= rate <= _FASTEST and speed < _TOO_FAST * 5:
        return None
    fits = {
        f: abs(np.log(rate / f / _USUAL))
        for f in _UNITS
        if _SLOWEST <= rate / f <= _FASTEST and speed / f < _TOO_FAST
    }
    if not fits or (_SLOWEST <= rate <= _FASTEST and max(fits) < 1):
        return None
    scale = min(fits, key=fits.__getitem__)
    words = (
        f"{rate:.3g} samples per second, the fastest joint at {speed:.2g} of its speed "
        f"limit: time looks like {_UNITS[scale]}."
    )
    return Fault("time_unit", (), True, words, (Repair("t", scale=scale),))


def uneven(recording: Recording) -> list[Fault]:
    """Find gaps in time and steps of unequal length."""
    steps = np.diff(recording.t)
    if len(steps) < 10:
        return []
    usual, words = float(np.median(steps)), []
    gaps = np.flatnonzero(steps > _GAP * usual)
    if len(gaps):
        worst = int(np.argmax(steps))
        words.append(
            f"{len(gaps)} gap{'s' if len(gaps) > 1 else ''}, the largest "
            f"{steps[worst]:.3g} s at t = {recording.t[worst]:.6g} s"
        )
    jitter = float(np.quantile(np.abs(steps - usual), 0.9)) / usual
    if jitter > _UNEVEN:
        words.append(f"a tenth of the steps are off by more than {100 * jitter:.0f} %")
    if not words:
        return []
    evidence = (
        f"The steps of time are {1000 * usual:.4g} ms but for {', and '.join(words)}."
    )
    return [Fault("clock", (), False, evidence, (), recording.id)]


def _speed(recording: Recording) -> Array:
    """Usual largest speed of each joint, over twenty samples. Shape (dof,)."""
    stride = max(1, min(20, len(recording.t) // 10))
    return usual_speed(recording, stride, _SHARE)
