"""Windows of logs (FILE@start:end), and checks of samples against the robot."""

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from residual.errors import InputError, RecordingError, shorten_value
from residual.recording import Array, Recording, compute_speed_quantile
from residual.robot.limits import drop_placeholder_limits
from residual.robot.robot import Robot

_EDGE = r"(\d+(?:\.\d*)?|\.\d+)(%?)"
_WINDOW = re.compile(f"(?:{_EDGE})?:(?:{_EDGE})?")

# Equal samples in a row that are no coincidence, however coarse the sensors.
RUN = 5
# Alternating readings of two arms: shares of a joint's span, of samples, of jumps.
LEAP, LEAPS, BACK = 0.05, 0.02, 0.95
NEARER = 3.0  # factor by which the next reading but one is nearer where two arms alternate
GAP = 1.5  # times the median time step
STEPS = 32  # least number of distinct readings; a joint with fewer is at rest
BLOCK = 1 << 17  # samples per block
# A joint that moves by less than this share of the largest span within _LATELY rests.
STILL, _LATELY = 0.002, 0.2  # 1, s


@dataclass(frozen=True, slots=True)
class LogWindow:
    """A span of a log: [start, end) in time from its first sample."""

    text: str  # as the user wrote it, without the "@"
    start: float = 0.0  # start [s], or [%] of the whole time
    end: float | None = None  # end, None for the end of the log
    start_percent: bool = False  # whether start is a percentage
    end_percent: bool = False  # whether end is a percentage

    def rows(self, t: Array, where: str) -> slice:
        """Return the rows of the window.

        Args:
            t: Sample times, strictly increasing [s]. Shape (n,).
        """
        step = float(np.median(np.diff(t)))
        # One step longer than last minus first, so that 100 % has the last sample.
        length = float(t[-1] - t[0]) + step
        start = self.start * length / 100 if self.start_percent else self.start
        end = length if self.end is None else self.end
        end = end * length / 100 if self.end_percent else end
        if start >= length - step / 2 or end > length + step / 2:
            raise InputError(
                f"{where}: window @{shorten_value(self.text)} is outside the log, "
                f"which lasts {length:.6g} s. Times count from its first sample."
            )
        if end <= start:
            raise InputError(
                f"{where}: window @{shorten_value(self.text)} is empty: end before start."
            )
        # A hair early, so that 2.5 s is not missed by the rounding of a clock.
        edges = np.searchsorted(t - t[0], np.array([start, end]) - 1e-3 * step)
        last = len(t) if end >= length - step / 2 else int(edges[1])
        return slice(int(edges[0]), last)


def split_log_spec(spec: str) -> tuple[Path, LogWindow | None]:
    """Split the words for a log into its file and its window.

    Args:
        spec: "FILE" or "FILE@start:end"; a file of the full name wins.
    """
    path = Path(spec)
    # From os.path, which return False for an impossible file name.
    if "@" not in path.name or os.path.exists(path):
        return _existing(path), None
    name, _, text = spec.rpartition("@")
    match = _WINDOW.fullmatch(text)
    if match is None or not name:
        raise InputError(
            f"{shorten_value(path.name)}: window @{shorten_value(text)} is not "
            "understood, expected @start:end in seconds or percent, such as @0:16.5, "
            "@60%: or @:60%."
        )
    start, start_percent, end, end_percent = match.groups()
    window = LogWindow(
        text,
        float(start or 0),
        None if end is None else float(end),
        bool(start_percent),
        bool(end_percent),
    )
    for edge, percent in ((start, start_percent), (end, end_percent)):
        if percent and float(edge) > 100:
            raise InputError(
                f"{shorten_value(path.name)}: {shorten_value(edge)}% is outside the "
                "log, expected 0 to 100 %."
            )
    return _existing(Path(name)), window


def create_unique_labels(specs: Sequence[str]) -> list[str]:
    """Return a short label for each log, no two alike."""
    parts = [split_log_spec(spec) for spec in specs]
    tails = ["" if window is None else f"@{window.text}" for _, window in parts]
    ids = [f"{path.stem}{tail}" for (path, _), tail in zip(parts, tails, strict=True)]
    longer = [
        f"{path.resolve().parent.name}/{path.name}{tail}"
        for (path, _), tail in zip(parts, tails, strict=True)
    ]
    counts = Counter(ids)
    ids = [a if counts[a] == 1 else b for a, b in zip(ids, longer, strict=True)]
    counts, counted = Counter(ids), Counter()
    for i, label in enumerate(ids):
        counted[label] += 1
        if counts[label] > 1:
            ids[i] = f"{label} ({counted[label]})"
    return ids


def _existing(path: Path) -> Path:
    if os.path.isfile(path / "metadata.yaml"):
        return path  # a bag of ROS 2
    if os.path.isdir(path):
        raise InputError(
            f"{path} is a folder, expected a log file, or the folder of a "
            "ROS 2 bag with its metadata.yaml."
        )
    if not os.path.exists(path):
        raise InputError(
            f"No log file '{shorten_value(path)}'. Give a CSV, Parquet, MCAP or ROS "
            "bag file, or, where a command reads the store, the id of a run (modelgap runs)."
        )
    if not os.path.isfile(path):
        raise InputError(
            f"{path} is not a regular file, expected a CSV, Parquet, MCAP or ROS bag file."
        )
    return path


def check_logs_distinct(recordings: Sequence[Recording]) -> None:
    """Refuse logs that share samples of a motion: overlapping windows, or a copy.

    Samples are compared by position and torque, not by time, since a copy may have
    another clock. Samples at standstill do not count: two simulated runs of one seed
    are equal until the arm moves.
    """
    if len(recordings) < 2:
        return
    prints = [_runs(recording) for recording in recordings]
    runs, moving = (np.concatenate(each) for each in zip(*prints, strict=True))
    log = np.repeat(np.arange(len(prints)), [len(own) for own, _ in prints])
    order = np.argsort(runs, kind="stable")
    again = np.flatnonzero(runs[order[1:]] == runs[order[:-1]])
    pairs = np.stack([order[again], order[again + 1]])
    pairs = pairs[:, moving[pairs].any(axis=0)]
    if not pairs.size:
        return
    i, j = min(zip(*log[pairs].tolist(), strict=True))
    shared = np.intersect1d(prints[i][0], prints[j][0], assume_unique=True)
    raise InputError(
        f"'{recordings[i].id}' and '{recordings[j].id}' hold the same samples "
        f"(about {len(shared) + RUN - 1}). Give every sample once: other logs, "
        "or windows that do not overlap."
    )


def _runs(recording: Recording) -> tuple[Array, Array]:
    """Return one number for every RUN samples in a row, and whether the arm moves."""
    factors = np.random.default_rng(0).integers(2**63, size=(2, 64), dtype=np.uint64) | 1
    blocks = range(0, len(recording.t), BLOCK)
    parts = [_hashes(recording, start, factors[0]) for start in blocks]
    sample, row = (np.concatenate(each) for each in zip(*parts, strict=True))
    count = max(0, len(sample) - RUN + 1)
    runs = np.zeros(count, dtype=np.uint64)
    for k in range(RUN):
        runs += sample[k : k + count] * factors[1, k]
    runs, first = np.unique(runs, return_index=True)
    # Whether a joint has moved within the last tenths of a second.
    t, q = recording.t, recording.q
    least = STILL * 2 * _half_span(q).max()
    before = np.searchsorted(t, t - _LATELY)
    moving = (np.abs(q - q[before]) > least).any(axis=1)
    return runs, moving[row[first]]


def _hashes(recording: Recording, start: int, factors: Array) -> tuple[Array, Array]:
    """Return a hash for each sample that differs from the one before, and its row."""
    rows = slice(max(start - 1, 0), start + BLOCK)
    values = np.hstack([recording.q[rows], recording.tau[rows]])
    if recording.drive is not None:
        # Torque follows from the angles, and two motions may share steps: the clock
        # of a bus distinguishes them.
        ticks = np.diff(recording.t[rows], prepend=recording.t[rows][:1])
        values = np.column_stack([values, np.where(ticks > 0, ticks.round(6), 0.0)])
    # At standstill one sample repeats, in any log: count it once.
    signals = values[:, : 2 * recording.dof]
    changed = np.r_[start == 0, (np.diff(signals, axis=0) != 0).any(axis=1)]
    bits = np.ascontiguousarray(values[changed]).view(np.uint64)
    mixed = (bits ^ (bits >> np.uint64(29))) * factors[: bits.shape[1]]
    hashes = np.bitwise_xor.reduce(mixed ^ (mixed >> np.uint64(32)), axis=1)
    return hashes, rows.start + np.flatnonzero(changed)


# Checks of the samples of a log against the robot.


MIN_DURATION = 2.0
MIN_RATE = 10.0
# Tolerance of a position outside the range of its joint [rad].
LIMIT_SLACK = 0.2
# Excess over the rated speed that no arm reaches, but degrees read as radians.
SPEED_SLACK = 5.0
_SHARE = 0.95  # of the samples are slower
# Units of clocks other than seconds [s].
_UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True, slots=True)
class LogDoubt:
    """Why a log as read cannot be of this arm."""

    kind: str  # kind of fault (docs/check.md)
    joints: tuple[int, ...]  # its joints, from 1; () for all
    words: str  # the fault and the remedy, in one or two lines
    fatal: bool = False  # whether the log cannot be evaluated
    certain: bool = True  # whether the log is unusable in any case


def find_time_fault(t: Array, source: str) -> str | None:
    """Return the fault of the times of a file: not finite, or not increasing.

    Args:
        t: Times [s]. Shape (n,).
    """
    if len(t) < 2:
        raise RecordingError(f"{source} has {len(t)} samples, expected a log of 2 s.")
    if not np.isfinite(t).all():
        row = int(np.argmin(np.isfinite(t)))
        return f"{source}: time is NaN or infinite at sample {row}. Cut that row out."
    steps = np.diff(t)
    if steps.min() > 0:
        return None
    row = int(np.argmax(steps <= 0)) + 1
    how = "repeats" if steps[row - 1] == 0 else "runs backwards"
    return (
        f"{source}: time {how} at sample {row} ({t[row]:.9g} s after "
        f"{t[row - 1]:.9g} s). Remove or reorder these samples."
    )


def find_implausible_samples(log: Recording, robot: Robot) -> tuple[LogDoubt, ...]:
    """Return what no log of this arm can be: too short, too slow, without motion, out of range."""
    robot = drop_placeholder_limits(robot, [log])
    # A signal out of range needs no check of its speed.
    checks = (_short(log), _constant(log))
    where = _out_of_range(log, robot) or _too_fast(log, robot)
    return tuple(doubt for doubt in (*checks, where) if doubt)


def _short(recording: Recording) -> LogDoubt | None:
    rows = len(recording.t)
    # Every sample counts for the step after it: 500 at 250 Hz are 2 s.
    duration = recording.duration * rows / (rows - 1)
    if duration < MIN_DURATION * (1 - 1e-3):
        words = (
            f"{recording.id} lasts {duration:.3g} s, expected at least "
            f"{MIN_DURATION:g} s. Record longer; is the unit of time right (--map)?"
        )
        return LogDoubt("too_short", (), words, fatal=True)
    if rows / duration < MIN_RATE:
        words = (
            f"{recording.id} has {rows / duration:.3g} samples per second, expected at "
            f"least {MIN_RATE:g}.\n{_why_slow(recording.t)}"
        )
        return LogDoubt("time_unit", (), words, fatal=True)
    return None


def _why_slow(t: Array) -> str:
    """Return the likely cause of times that are too far apart."""
    steps = np.diff(t)
    step, row = float(np.median(steps)), int(np.argmax(steps))
    if step * MIN_RATE <= 1:
        return (
            f"It stops for {steps[row]:.6g} s after sample {row}. Give the parts "
            "before and after by themselves: FILE@start:end."
        )
    for unit, factor in _UNITS.items():
        if step * factor * MIN_RATE <= 1:
            how = f"unit = '{unit}'" if unit != "ns" else "unit = 'us', scale = 1e-3"
            return f"Time in {unit}? Say so in --map: time = {{{how}}}."
    return "Record faster, or say in --map what time is in: time = {unit = ...}."


SPOILT = 3  # samples in a row that a bus may corrupt
FAR, BEYOND = 0.3, 6.0  # rad; times the largest of all other steps but a few


def find_leaps(q: Array) -> Array:
    """Return the samples of isolated jumps of an angle. Shape (n,), bool.

    A corrupted reading is no motion: up to three samples are far from both neighbours,
    which are near each other.

    Args:
        q: Angles [rad]. Shape (n, dof).
    """
    out = np.zeros(len(q), bool)
    if len(q) < RUN:
        return out
    step = np.abs(np.diff(q, axis=0))
    far = np.maximum(FAR, BEYOND * np.quantile(step, 0.98, axis=0))
    for k in range(1, SPOILT + 1):
        over = np.abs(q[k + 1 :] - q[: -k - 1])
        edges = np.minimum(step[:-k], step[k:])
        starts = np.flatnonzero((edges > np.maximum(far, 2 * over)).any(axis=1)) + 1
        for i in range(k):
            out[starts + i] = True
    return out


def find_interleaved_arms(q: Array, source: str, t: Array) -> LogDoubt | None:
    """Find alternating readings of two arms: jumps back and forth that no joint can do.

    Args:
        q: Readings in any unit, all rows. Shape (n, dof).
        t: Their times; over a gap, where samples were left out, any jump is possible.
    """
    if len(q) < RUN or np.isnan(q).all(axis=0).any():
        return None
    if _in_turn(q):
        return _two_arms(source, len(q) - 1, len(q))
    signs = np.stack([_leaps(joint_angles) for joint_angles in q.T], axis=1)
    steps = np.diff(t)
    signs[steps > GAP * np.nanmedian(steps)] = 0
    # A single joint jumps where its reading is coarse or wraps.
    least, most = min(2, q.shape[1]), max(LEAPS * len(q), RUN)
    if np.count_nonzero(np.abs(signs).sum(axis=1) >= least) < most:
        return None
    signs *= [_moves(joint_angles) for joint_angles in q.T]
    rows = np.flatnonzero(np.abs(signs).sum(axis=1) >= least)
    if len(rows) < most:
        return None
    pairs = signs[rows][1:] * signs[rows][:-1]
    back = pairs[pairs != 0] < 0
    if not len(back) or back.mean() < BACK:
        return None
    return _two_arms(source, len(rows), len(q))


def _two_arms(where: str, leaps: int, samples: int) -> LogDoubt:
    words = (
        f"{where}: the angles jump back and forth {leaps} times in {samples} "
        "samples, as no joint can: two arms or drivers are interleaved in it. Log one "
        "of them: its topic by itself, or its joints under their names."
    )
    return LogDoubt("interleaved", (), words, fatal=True)


def _in_turn(q: Array) -> bool:
    """Whether the next reading but one is much nearer than the next, on two joints.

    For one arm it is twice as far in motion, and as far in noise. Long logs are sampled
    evenly, since every log passes this check.
    """
    at = np.arange(0, len(q) - 2, 1 + len(q) // BLOCK)
    first, second = (np.nanmedian(np.abs(q[at + k] - q[at]), axis=0) for k in (1, 2))
    nearer = np.flatnonzero(first > NEARER * second)
    return sum(_moves(q[:, j]) for j in nearer) >= min(2, q.shape[1])


def _moves(angles: Array) -> bool:
    """Whether a joint moves: at rest it jitters by one step of its encoder."""
    return len(np.unique(angles)) > STEPS


def _leaps(angles: Array) -> Array:
    """Size of each step that is large for a joint, 0 for the others. Shape (n - 1,)."""
    step = np.diff(angles)
    far = np.abs(step) > LEAP * (np.nanmax(angles) - np.nanmin(angles))
    return (np.where(far, np.sign(step), 0)).astype(np.int8)


def _constant(recording: Recording) -> LogDoubt | None:
    if _half_span(recording.q).max() < 1e-6:
        words = (
            f"{recording.id}: q is constant on all joints, expected motion. "
            "Give a log in which the arm moves."
        )
        return LogDoubt("frozen", (), words, fatal=True)
    frozen = [int(j) + 1 for j in np.flatnonzero(_half_span(recording.tau) == 0)]
    if not frozen:
        return None
    joints = "all joints" if len(frozen) == recording.dof else f"joint {frozen[0]}"
    words = (
        f"{recording.id}: tau is constant on {joints}, expected a signal. Give a "
        "log with measured torques or currents of every joint."
    )
    return LogDoubt("frozen", tuple(frozen), words, fatal=True)


def _half_span(x: Array) -> Array:
    """Half of the span of each column; halved first to avoid overflow. (k,)."""
    return x.max(axis=0) / 2 - x.min(axis=0) / 2


def _out_of_range(recording: Recording, robot: Robot) -> LogDoubt | None:
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
        f"joint's range is {robot.lower[joint]:.3g} to {robot.upper[joint]:.3g} rad.\n{hint}"
    )
    kind, joints = ("angle_unit", ()) if degrees else ("out_of_range", (joint + 1,))
    return LogDoubt(kind, joints, words)


def _too_fast(recording: Recording, robot: Robot) -> LogDoubt | None:
    # Over a tenth of a second, so that the steps of an encoder do not count.
    stride = max(1, int(0.1 * len(recording.t) / recording.duration))
    if stride >= len(recording.t):
        return None
    speed = compute_speed_quantile(recording, stride, _SHARE)
    ratio = speed / robot.velocity_limit
    if ratio.max() <= SPEED_SLACK:
        return None
    joint = int(np.argmax(ratio))
    words = (
        f"{recording.id}: q{joint + 1} moves at {speed[joint]:.3g} rad/s, the "
        f"joint's limit is {robot.velocity_limit[joint]:.3g} rad/s.\n"
        "Degrees, or time in another unit? Say so in --map COLUMNS.toml."
    )
    return LogDoubt("out_of_range", (joint + 1,), words)


def describe_log_oddities(recording: Recording) -> tuple[str, ...]:
    """Return odd but usable features of a log, in words."""
    messages = []
    still = np.flatnonzero(_half_span(recording.q) == 0) + 1
    if len(still):
        joints = ", ".join(f"q{j}" for j in still)
        messages.append(f"{recording.id}: {joints} never changes; is it logged?")
    steps = np.diff(recording.t)
    gap = int(np.argmax(steps))
    gaps = int(np.sum(steps > 5 * np.median(steps)))
    if gaps:
        messages.append(
            f"{recording.id}: {gaps} gap(s) in time, the largest {steps[gap]:.3g} s at "
            f"t = {recording.t[gap]:.6g} s."
        )
    return tuple(messages)
