"""Whether the samples of a log can be what they claim to be."""

import numpy as np

from residual.errors import RecordingError
from residual.recording import Recording
from residual.robot.robot import Robot

Array = np.ndarray

MIN_DURATION = 2.0
MIN_RATE = 10.0
# How far a position may lie outside the range of its joint [rad].
LIMIT_SLACK = 0.2
# No arm goes so much faster than its rating; degrees read as radians do.
SPEED_SLACK = 5.0


def check_time(t: Array, where: str) -> None:
    """Check the time column of a whole file.

    Args:
        t: Times [s]. Shape (n,).
        where: File name, as messages begin.

    Raises:
        RecordingError: If there are no samples, or time is not finite and increasing.
    """
    if len(t) < 2:
        raise RecordingError(f"{where} has {len(t)} samples, expected a log of 2 s.")
    if not np.isfinite(t).all():
        row = int(np.argmin(np.isfinite(t)))
        raise RecordingError(f"{where}: time is NaN or infinite at sample {row}.")
    steps = np.diff(t)
    if steps.min() <= 0:
        row = int(np.argmax(steps <= 0)) + 1
        how = "repeats" if steps[row - 1] == 0 else "runs backwards"
        raise RecordingError(
            f"{where}: time {how} at sample {row} ({t[row]:.9g} s after "
            f"{t[row - 1]:.9g} s). Remove or reorder these samples."
        )


def check_samples(recording: Recording, robot: Robot) -> tuple[str, ...]:
    """Check what a log says against what an arm can do.

    Args:
        recording: The log.
        robot: The arm.

    Returns:
        What is odd but usable, in words.

    Raises:
        RecordingError: If the log is too short or too slow, nothing moves, or the
            positions cannot be those of the arm.
    """
    _check_length(recording)
    _check_constant(recording)
    _check_range(recording, robot)
    _check_speed(recording, robot)
    return _odd(recording)


def _check_length(recording: Recording) -> None:
    rows = len(recording.t)
    # Every sample stands for the step that follows it: 500 at 250 Hz are 2 s.
    duration = recording.duration * rows / (rows - 1)
    if duration < MIN_DURATION * (1 - 1e-3):
        raise RecordingError(
            f"{recording.id} lasts {duration:.3g} s, expected at least "
            f"{MIN_DURATION:g} s. Record longer; is the unit of time right (--map)?"
        )
    if rows / duration < MIN_RATE:
        raise RecordingError(
            f"{recording.id} has {rows / duration:.3g} samples per second, expected at "
            f"least {MIN_RATE:g}.\nTime in ms? Say so in --map: time = {{unit = 'ms'}}."
        )


def _check_constant(recording: Recording) -> None:
    if np.ptp(recording.q, axis=0).max() < 1e-6:
        raise RecordingError(
            f"{recording.id}: q is constant on all joints, expected motion. "
            "Give a log in which the arm moves."
        )
    frozen = [j + 1 for j in np.flatnonzero(np.ptp(recording.tau, axis=0) == 0)]
    if frozen:
        joints = "all joints" if len(frozen) == recording.dof else f"joint {frozen[0]}"
        raise RecordingError(
            f"{recording.id}: tau is constant on {joints}, expected a signal. Give a "
            "log with measured torques or currents of every joint."
        )


def _check_range(recording: Recording, robot: Robot) -> None:
    q = recording.q
    beyond = np.maximum(robot.lower - q, q - robot.upper).max(axis=0)
    if beyond.max() <= LIMIT_SLACK:
        return
    joint = int(np.argmax(beyond))
    low, high = q[:, joint].min(), q[:, joint].max()
    as_degrees = np.deg2rad(q)
    inside = np.maximum(robot.lower - as_degrees, as_degrees - robot.upper).max()
    hint = (
        "Degrees? Say so in --map: q = {columns = [...], unit = 'deg'}."
        if inside <= LIMIT_SLACK and max(-low, high) > 4
        else "Check zero, sign and unit (--map), or the limits in the URDF."
    )
    raise RecordingError(
        f"{recording.id}: q{joint + 1} runs from {low:.3g} to {high:.3g} rad, the "
        f"joint's range is {robot.lower[joint]:.3g} to {robot.upper[joint]:.3g} rad.\n"
        f"{hint}"
    )


def _check_speed(recording: Recording, robot: Robot) -> None:
    # Over a tenth of a second, so that the steps of an encoder do not count.
    stride = max(1, int(0.1 * len(recording.t) / recording.duration))
    t, q = recording.t[::stride], recording.q[::stride]
    speed = np.quantile(np.abs(np.diff(q, axis=0) / np.diff(t)[:, None]), 0.95, axis=0)
    ratio = speed / robot.velocity_limit
    if ratio.max() > SPEED_SLACK:
        joint = int(np.argmax(ratio))
        raise RecordingError(
            f"{recording.id}: q{joint + 1} moves at {speed[joint]:.3g} rad/s, the "
            f"joint's limit is {robot.velocity_limit[joint]:.3g} rad/s.\n"
            "Degrees, or time in another unit? Say so in --map COLUMNS.toml."
        )


def _odd(recording: Recording) -> tuple[str, ...]:
    odd = []
    still = np.flatnonzero(np.ptp(recording.q, axis=0) == 0) + 1
    if len(still):
        joints = ", ".join(f"q{j}" for j in still)
        odd.append(f"{recording.id}: {joints} never changes; is it logged?")
    steps = np.diff(recording.t)
    gap = int(np.argmax(steps))
    gaps = int(np.sum(steps > 5 * np.median(steps)))
    if gaps:
        odd.append(
            f"{recording.id}: {gaps} gap(s) in time, the largest {steps[gap]:.3g} s at "
            f"t = {recording.t[gap]:.6g} s."
        )
    return tuple(odd)
