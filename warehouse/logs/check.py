"""Whether the samples of a log can be what they claim to be."""

from dataclasses import dataclass

import numpy as np

from residual.errors import RecordingError
from residual.recording import Recording, usual_speed
from residual.robot.robot import Robot

Array = np.ndarray

MIN_DURATION = 2.0
MIN_RATE = 10.0
# How far a position may lie outside the range of its joint [rad].
LIMIT_SLACK = 0.2
# No arm goes so much faster than its rating; degrees read as radians do.
SPEED_SLACK = 5.0
_SHARE = 0.95  # of the samples are slower
# What clocks count in besides seconds [s].
_UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True, slots=True)
class Doubt:
    """Why a log as it was read is none of this arm.

    Attributes:
        kind: What sort of fault it is (docs/check.md).
        joints: Its joints, from 1; () for all.
        words: What was found and what to do, in one or two lines.
        fatal: Whether nothing can be computed from such a log.
    """

    kind: str
    joints: tuple[int, ...]
    words: str
    fatal: bool = False


def time_fault(t: Array, where: str) -> str | None:
    """Return what is wrong with the times of a whole file: not finite or increasing.

    Args:
        t: Times [s]. Shape (n,).

    Raises:
        RecordingError: If there are no samples.
    """
    if len(t) < 2:
        raise RecordingError(f"{where} has {len(t)} samples, expected a log of 2 s.")
    if not np.isfinite(t).all():
        row = int(np.argmin(np.isfinite(t)))
        return f"{where}: time is NaN or infinite at sample {row}. Cut that row out."
    steps = np.diff(t)
    if steps.min() > 0:
        return None
    row = int(np.argmax(steps <= 0)) + 1
    how = "repeats" if steps[row - 1] == 0 else "runs backwards"
    return (
        f"{where}: time {how} at sample {row} ({t[row]:.9g} s after "
        f"{t[row - 1]:.9g} s). Remove or reorder these samples."
    )


def check_samples(recording: Recording, robot: Robot) -> tuple[Doubt, ...]:
    """Check what a log says against what an arm can do.

    Returns:
        What no log of this arm can be: too short or too slow, without motion, or at
        positions and speeds that the arm does not have; empty for a usable log.
    """
    # Of what is out of range the speed says no more.
    checks = (_short(recording), _constant(recording))
    where = _out_of_range(recording, robot) or _too_fast(recording, robot)
    return tuple(doubt for doubt in (*checks, where) if doubt)


def _short(recording: Recording) -> Doubt | None:
    rows = len(recording.t)
    # Every sample stands for the step that follows it: 500 at 250 Hz are 2 s.
    duration = recording.duration * rows / (rows - 1)
    if duration < MIN_DURATION * (1 - 1e-3):
        words = (
            f"{recording.id} lasts {duration:.3g} s, expected at least "
            f"{MIN_DURATION:g} s. Record longer; is the unit of time right (--map)?"
        )
        return Doubt("too_short", (), words, fatal=True)
    if rows / duration < MIN_RATE:
        words = (
            f"{recording.id} has {rows / duration:.3g} samples per second, expected at "
            f"least {MIN_RATE:g}.\n{_why_slow(recording.t)}"
        )
        return Doubt("time_unit", (), words, fatal=True)
    return None


def _why_slow(t: Array) -> str:
    """Return what may be wrong with times that are too far apart."""
    steps = np.diff(t)
    usual, row = float(np.median(steps)), int(np.argmax(steps))
    if usual * MIN_RATE <= 1:
        return (
            f"It stops for {steps[row]:.6g} s after sample {row}. Give the parts "
            "before and after by themselves: FILE@start:end."
        )
    for unit, factor in _UNITS.items():
        if usual * factor * MIN_RATE <= 1:
            how = f"unit = '{unit}'" if unit != "ns" else "unit = 'us', scale = 1e-3"
            return f"Time in {unit}? Say so in --map: time = {{{how}}}."
    return "Record faster, or say in --map what time is in: time = {unit = ...}."


def _constant(recording: Recording) -> Doubt | None:
    if _half_span(recording.q).max() < 1e-6:
        words = (
            f"{recording.id}: q is constant on all joints, expected motion. "
            "Give a log in which the arm moves."
        )
        return Doubt("frozen", (), words, fatal=True)
    frozen = [int(j) + 1 for j in np.flatnonzero(_half_span(recording.tau) == 0)]
    if not frozen:
        return None
    joints = "all joints" if len(frozen) == recording.dof else f"joint {frozen[0]}"
    words = (
        f"{recording.id}: tau is constant on {joints}, expected a signal. Give a "
        "log with measured torques or currents of every joint."
    )
    return Doubt("frozen", tuple(frozen), words, fatal=True)


def _half_span(x: Array) -> Array:
    """Half of the span of each column; halves first, since both may be huge. (k,)."""
    return x.max(axis=0) / 2 - x.min(axis=0) / 2


def _out_of_range(recording: Recording, robot: Robot) -> Doubt | None:
    q = recording.q
    beyond = np.maximum(robot.lower - q.min(axis=0), q.max(axis=0) - robot.upper)
    if beyond.max() <= LIMIT_SLACK:
        return None
    joint = int(np.argmax(beyond))
    low, high = q[:, joint].min(), q[:, joint].max()
    as_degrees = np.deg2rad(q)
    inside = np.maximum(robot.lower - as_degrees, as_degrees - robot.upper).max()
    degrees = inside <= LIMIT_SLACK and max(-low, high) > 4
    hint = (
        "Degrees? Say so in --map: q = {columns = [...], unit = 'deg'}."
        if degrees
        else "Check zero, sign and unit (--map), or the limits in the URDF."
    )
    words = (
        f"{recording.id}: q{joint + 1} runs from {low:.3g} to {high:.3g} rad, the "
        f"joint's range is {robot.lower[joint]:.3g} to {robot.upper[joint]:.3g} rad.\n"
        f"{hint}"
    )
    kind, joints = ("angle_unit", ()) if degrees else ("out_of_range", (joint + 1,))
    return Doubt(kind, joints, words)


def _too_fast(recording: Recording, robot: Robot) -> Doubt | None:
    # Over a tenth of a second, so that the steps of an encoder do not count.
    stride = max(1, int(0.1 * len(recording.t) / recording.duration))
    if stride >= len(recording.t):
        return None
    speed = usual_speed(recording, stride, _SHARE)
    ratio = speed / robot.velocity_limit
    if ratio.max() <= SPEED_SLACK:
        return None
    joint = int(np.argmax(ratio))
    words = (
        f"{recording.id}: q{joint + 1} moves at {speed[joint]:.3g} rad/s, the "
        f"joint's limit is {robot.velocity_limit[joint]:.3g} rad/s.\n"
        "Degrees, or time in another unit? Say so in --map COLUMNS.toml."
    )
    return Doubt("out_of_range", (joint + 1,), words)


def odd(recording: Recording) -> tuple[str, ...]:
    """Return what is odd about a log but usable, in words."""
    said = []
    still = np.flatnonzero(_half_span(recording.q) == 0) + 1
    if len(still):
        joints = ", ".join(f"q{j}" for j in still)
        said.append(f"{recording.id}: {joints} never changes; is it logged?")
    steps = np.diff(recording.t)
    gap = int(np.argmax(steps))
    gaps = int(np.sum(steps > 5 * np.median(steps)))
    if gaps:
        said.append(
            f"{recording.id}: {gaps} gap(s) in time, the largest {steps[gap]:.3g} s at "
            f"t = {recording.t[gap]:.6g} s."
        )
    return tuple(said)
