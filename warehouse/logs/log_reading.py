"""Open a log by its content and read it into a checked recording."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np
import pyarrow as pa

from residual.errors import InputError, RecordingError, shorten_value
from residual.plugins import load_plugins
from residual.recording import Recording, apply_drive
from residual.robot.robot import Robot
from warehouse.logs.column_map import (
    ColumnMap,
    ColumnSelection,
    abbreviate_column_names,
    check_column_units,
    choose_column_map,
    convert_to_link_side,
    describe_conversion,
    list_signal_channels,
    select_columns,
)
from warehouse.logs.log_tables import HEAD, CsvLog, LogFile, ParquetLog, convert_epoch_seconds
from warehouse.logs.log_window import (
    LogDoubt,
    LogWindow,
    describe_log_oddities,
    find_implausible_samples,
    find_interleaved_arms,
    find_leaps,
    find_time_fault,
    split_log_spec,
)
from warehouse.logs.ros_bags import open_bag

Array = np.ndarray

LARGEST = 1e30  # in any SI unit: no sensor measures more, and sums of squares overflow
MOST_MASKED = 0.1  # largest share of samples of a log without a number
LARGE = 1 << 26  # bytes of one signal: some twenty minutes at 1 kHz
# The first bytes of each format; all other files are text.
_BAGS, _PARQUET = (b"SQLite format 3\0", b"#ROSBAG V", b"\x89MCAP"), b"PAR1"
_BINARY = re.compile(rb"[\x00-\x08\x0b\x0e-\x1f]")  # control characters


def find_increasing_rows(t: Array, source: str) -> tuple[Array, tuple[LogDoubt, ...]]:
    """Return the rows whose time is a number and later than all before.

    Args:
        t: Times [s]. Shape (n,).
    """
    t = np.where(np.abs(t) < LARGEST, t, np.nan)
    wrong = find_time_fault(t, source)
    if wrong is None:
        return np.ones(len(t), bool), ()
    latest = np.maximum.accumulate(np.where(np.isfinite(t), t, -np.inf))
    keep = np.isfinite(t) & (t > np.r_[-np.inf, latest[:-1]])
    return keep, (LogDoubt("clock", (), f"{wrong} {_share(keep)}"),)


def drop_repeated_rows(
    table: dict[str, Array], time: str
) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Return the rows of a table without repeated ones, and a note.

    Args:
        table: Columns of the file by name, that of time among them. Shapes (n,).
    """
    order = np.argsort(table[time], kind="stable")
    same = np.diff(table[time][order]) == 0
    if not same.any():
        return table, ()
    for x in table.values():
        same &= np.diff(x[order]) == 0
    keep = np.ones(len(order), bool)
    keep[order[1:][same]] = False
    words = f"{int(same.sum())} rows are duplicates; each is read once"
    return {k: x[keep] for k, x in table.items()}, (words,) if same.any() else ()


def find_finite_rows(
    signals: Mapping[str, Array], source: str
) -> tuple[Array, tuple[LogDoubt, ...]]:
    """Return the rows in which every signal is a plausible number.

    Args:
        signals: Values by name. Shapes (n, dof).
    """
    # Not a number compares as false.
    bad = {k: ~((x > -LARGEST) & (x < LARGEST)) for k, x in signals.items()}
    keep = ~np.any([mask.any(axis=1) for mask in bad.values()], axis=0)
    doubts = []
    for name, mask in bad.items():
        joints = tuple(int(j) + 1 for j in np.flatnonzero(mask.any(axis=0)))
        if joints:
            row = int(np.argmax(mask.any(axis=1)))
            first = signals[name][row][mask[row]][0]
            shown_value = f"{first:.3g}" if np.isfinite(first) else "NaN or infinite"
            remedy = (
                "Cut the log there with a window (FILE@start:end) or repair it."
                if keep.any()
                else "Name a column with numbers in the map (--map)."
            )
            words = f"{source}: {name} is {shown_value} at sample {row}. {remedy} "
            words += _share(keep)
            doubts.append(LogDoubt("spike", joints, words))
    return keep, tuple(doubts)


def _share(keep: Array) -> str:
    return f"{int(np.sum(~keep))} of {len(keep)} samples are affected."


def move_large_array_to_disk(values: Array) -> Array:
    """Return the same values, memory-mapped from a temporary file if they are large.

    They are in an unnamed file in TMPDIR, which disappears with its last use.
    """
    values = np.ascontiguousarray(values, dtype=float)
    if values.nbytes >= LARGE:
        with TemporaryFile(prefix="modelgap-") as file:
            file.write(values)
            file.flush()
            values = np.memmap(file, float, "r", shape=values.shape)
    values.setflags(write=False)
    return values


def open_log(path: Path, columns: ColumnMap, joints: Sequence[str]) -> LogFile:
    """Open a log with the first reader that recognizes it: plug-ins, then ours.

    Each takes the file, its first bytes (none of a folder), the map and the names of
    the joints, and returns None for a file that it does not recognize.

    Args:
        path: An existing file, or the folder of a ROS 2 bag.
        joints: Names of the robot's joints in the URDF, joint 1 first.
    """
    head = b""
    if not path.is_dir():
        try:
            with path.open("rb") as file:
                head = file.read(HEAD)
        except OSError as error:
            raise InputError(f"Cannot read {path}: {error.strerror}.") from error
        if not head.strip():
            raise InputError(f"{path.name} is empty, expected a log with samples.")
    for reader in load_plugins("modelgap.readers").values():
        log = reader(path, head, columns, joints)
        if log is not None:
            return log
    if path.is_dir() or head.startswith(_BAGS):
        return open_bag(path, joints, columns.bag)
    if head.startswith(_PARQUET):
        return ParquetLog(path)
    if _BINARY.search(head):
        raise InputError(
            f"{path.name} is binary but not Parquet, a ROS bag or MCAP, expected one "
            "of them or CSV text (UTF-8). Export the log as one of them."
        )
    return CsvLog(path, head, columns.csv)


@dataclass(frozen=True, slots=True)
class LogSummary:
    """The columns read and not read, and their conversions."""

    id: str  # label of the recording
    file: str  # file as the user wrote it, without the window
    window: str | None  # window as the user wrote it, None for the whole log
    rows: int  # number of samples
    rate: float  # mean sample rate [Hz]
    duration: float  # from the first to the last sample [s]
    used: tuple[str, ...]  # columns read
    ignored: tuple[str, ...]  # columns not read
    conversions: tuple[str, ...]  # every change of unit, side, sign or zero, in words
    warnings: tuple[str, ...]  # odd but usable features
    notes: tuple[str, ...] = ()  # what was understood of the file beyond its columns
    # Channel, column, unit and other conversions, one by one.
    channels: tuple[tuple[str, str, str, str], ...] = ()
    # Why the samples cannot be of this arm; empty for a usable log.
    doubts: tuple[LogDoubt, ...] = ()
    # Time of the first sample, UTC; None if unknown.
    recorded_at: datetime | None = None

    @property
    def text(self) -> str:
        """One line for the terminal."""
        size = f"{self.rows} samples, {self.rate:.4g} Hz, {self.duration:.4g} s"
        parts = [f"{self.id}: {size}", f"read {abbreviate_column_names(self.used)}"]
        if self.ignored:
            parts.append(f"ignored {abbreviate_column_names(self.ignored)}")
        parts += [*self.conversions, *self.notes]
        return "; ".join(parts)


def read_log(
    spec: str,
    robot: Robot,
    columns: ColumnMap | None = None,
    label: str | None = None,
    despite_doubts: bool = False,
) -> tuple[Recording, LogSummary]:
    """Read a log of any known format.

    Args:
        spec: "FILE" or "FILE@start:end".
        columns: The column map; None for that of the robot.toml, else t, q1..,
            tau1.. in SI units.
        label: Id of the recording; None for the file's stem and window.
        despite_doubts: Whether samples that cannot be of this arm are read too: rows
            without a number or with a time that does not increase are left out, and
            the faults are in the `doubts` of the summary.

    Returns:
        The recording, on the log's own clock, and a summary of the file.

    Raises:
        InputError: If the file, its columns or the window are not usable, or most
            samples are not numbers; without `despite_doubts` also if one is impossible.
    """
    columns = columns or choose_column_map(robot) or ColumnMap()
    path, window = split_log_spec(spec)
    tail = "" if window is None else f"@{window.text}"
    label = label or f"{path.stem}{tail}"
    log = open_log(path, columns, robot.joints)
    read = read_opened_log(log, robot, columns, label, str(path), window)
    return read if despite_doubts else _refuse_doubtful_log(*read)


def _refuse_doubtful_log(recording: Recording, summary: LogSummary) -> tuple[Recording, LogSummary]:
    for doubt in summary.doubts:
        if doubt.certain:
            raise RecordingError(doubt.words)
    return recording, summary


class MemoryLog(LogFile):
    """Columns that are in memory already: a mapping, or a data frame of any library.

    Args:
        table: Columns by name: a mapping, or a frame with ``columns`` or
            ``column_names``.
    """

    def __init__(self, table: Any, name: str) -> None:
        self.name = name
        names = getattr(table, "column_names", None)
        self._columns: dict[str, Array] = {}
        for key in getattr(table, "columns", table) if names is None else names:
            try:
                values = np.asarray(table[key])
            except (TypeError, ValueError):  # rows of different lengths
                values = np.empty((), object)
            if values.ndim == 2:  # q1, q2, ...
                parts = {f"{key}{j}": part for j, part in enumerate(values.T, 1)}
                self._columns |= parts
            elif values.ndim == 1:
                self._columns[str(key)] = values
            else:
                raise InputError(
                    f"{name}: column '{shorten_value(str(key))}' has shape {values.shape}, "
                    "expected one value per sample, or one per sample and joint."
                )
        self.columns = tuple(self._columns)

    def read(self, columns: tuple[str, ...]) -> dict[str, Array]:
        """Return the values of some columns, NaN where empty."""
        sizes = {name: len(self._columns[name]) for name in columns}
        if len({*sizes.values()}) > 1:
            some = ", ".join(f"{name}: {n}" for name, n in sizes.items())
            raise InputError(
                f"{self.name}: its columns differ in length ({shorten_value(some)}), "
                "expected the same number of samples in each."
            )
        for name in columns:
            kind = self._columns[name].dtype
            try:
                if kind.kind not in "fiuO":
                    raise TypeError
                self._columns[name] = self._columns[name].astype(float)
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"{self.name}: column '{shorten_value(name)}' holds {kind}, expected numbers."
                ) from error
        return {name: self._columns[name] for name in columns}


def read_memory_log(
    table: Mapping, robot: Robot, columns: ColumnMap | None = None, label: str = "log"
) -> tuple[Recording, LogSummary]:
    """Read a log in memory, as `read_log` reads a file.

    Args:
        table: Columns by name, 1-D; or a data frame.
    """
    columns = columns or choose_column_map(robot) or ColumnMap()
    log = MemoryLog(table, label)
    return _refuse_doubtful_log(*read_opened_log(log, robot, columns, label, label))


def read_opened_log(
    log: LogFile,
    robot: Robot,
    columns: ColumnMap,
    label: str,
    file: str,
    window: LogWindow | None = None,
) -> tuple[Recording, LogSummary]:
    """Read a log that is open, as `read_log`."""
    chosen = select_columns(log.columns, columns, robot, log.name)
    check_column_units(chosen, columns.time_unit, log.units, log.name)
    table = log.read(chosen.used)
    if chosen.nanoseconds:
        table[chosen.time] = table[chosen.time] + 1e-9 * table.pop(chosen.nanoseconds)
    table, again = drop_repeated_rows(table, chosen.time)
    t = table[chosen.time]
    first = t[np.isfinite(t).argmax()] if len(t) else np.nan
    locked_doubts = _locked_that_move(log, robot, label)
    recording, doubts = _samples(table, chosen, columns, robot, label, log.name, window)
    start = convert_epoch_seconds(recording.t[0])
    if log.recorded_at is not None:
        start = log.recorded_at + timedelta(
            seconds=float(recording.t[0] - first * columns.time_unit_seconds)
        )
    scale = columns.time_scale
    slower = "" if scale == 1 else f"times {scale:.6g}"
    clock = [f"t: {slower}"] if slower else []
    clock += [] if columns.time_unit == "s" else [f"t: {columns.time_unit} to s"]
    joints = chosen.signals.items()
    understood = LogSummary(
        id=label,
        file=file,
        window=None if window is None else window.text,
        rows=len(recording.t),
        rate=(len(recording.t) - 1) / recording.duration,
        duration=recording.duration,
        used=chosen.used,
        ignored=chosen.ignored,
        conversions=(*clock, *filter(None, (describe_conversion(n, s) for n, s in joints))),
        warnings=describe_log_oddities(recording),
        notes=(*log.notes, *again),
        channels=(
            ("t", chosen.time, columns.time_unit, slower),
            *(channel for n, s in joints for channel in list_signal_channels(n, s)),
        ),
        doubts=(*doubts, *locked_doubts),
        recorded_at=start,
    )
    return recording, understood


MOVED = 0.02  # rad or m: tolerance of a locked joint


def _locked_that_move(log: LogFile, robot: Robot, label: str) -> tuple[LogDoubt, ...]:
    """Return the joints outside of the chain that move in the log."""
    names = {f"{name}.position": name for name in robot.locked}
    logged = tuple(column for column in names if column in log.columns)
    table = log.read(logged)
    ways = {names[c]: float(np.nanmax(table[c]) - np.nanmin(table[c])) for c in logged}
    motions = [f"'{name}' by {way:.3g}" for name, way in ways.items() if way > MOVED]
    if not motions:
        return ()
    words = (
        f"{label}: locked joints move in the log: {', '.join(motions)} (rad or m). Add "
        "a lift or a rail that moves with the arm to --chain; fingers matter little."
    )
    return (LogDoubt("robot_file", (), words, certain=False),)


def _samples(
    table: dict[str, Array],
    chosen: ColumnSelection,
    columns: ColumnMap,
    robot: Robot,
    label: str,
    name: str,
    window: LogWindow | None,
) -> tuple[Recording, tuple[LogDoubt, ...]]:
    """Return the samples that are numbers, and what is wrong with the log."""
    with np.errstate(over="ignore", invalid="ignore"):
        t = table[chosen.time] * columns.time_unit_seconds
    q = np.column_stack([table[c] for c in chosen.signals["q"].columns])
    mixed = find_interleaved_arms(q, label, t)
    keep, doubts = find_increasing_rows(t, name)
    at = _rows(keep)
    if window is not None:
        selected = window.rows(t[at], name)
        at = selected if isinstance(at, slice) else at[selected]
    signals = {}
    for k, signal in chosen.signals.items():
        raw = np.column_stack([table.pop(c)[at] for c in signal.columns])
        with np.errstate(over="ignore", invalid="ignore"):  # huge become infinite
            signals[k] = convert_to_link_side(k, raw, signal, robot)
    if chosen.enabled:
        on = table.pop(chosen.enabled)[at, None]
        signals["enabled"] = np.repeat(on, robot.dof, axis=1)
    rows, broken = find_finite_rows(signals, label)
    masks = {}
    driven = columns.drive is not None
    # A few missing samples are masked; an impossible number is a fault.
    lacking = np.any([np.isnan(x).any(axis=1) for x in signals.values()], axis=0)
    masks_some = driven or (lacking.any() and (lacking == ~rows).all())
    if masks_some and rows.mean() >= 1 - MOST_MASKED:
        rows, masks["masked"], lost = _mask_rows(signals, rows, robot, driven)
        leaps = ", or isolated jumps" * driven
        words = f"{label}: {lost} samples are masked: not a number{leaps}."
        broken = (LogDoubt("spike", (), words, certain=False),) if lost else ()
    if rows.sum() < 2:
        reason = "\n".join(doubt.words for doubt in (*doubts, *broken)[:1])
        raise RecordingError(reason or f"{label} has {rows.sum()} samples; widen the window.")
    kept = _rows(rows)
    if driven:
        signals["tau"] = np.zeros_like(signals["q"])
    recording = Recording(
        id=label,
        robot=robot.name,
        t=move_large_array_to_disk(t[at][kept]),
        **{k: move_large_array_to_disk(signals.pop(k)[kept]) for k in tuple(signals)},
        **masks,
    )
    if driven:
        recording = apply_drive(recording, columns.drive)
    # Arrow keeps the memory of the parsed text: 700 MB for an hour.
    pa.default_memory_pool().release_unused()
    with np.errstate(over="ignore"):
        doubts = (*doubts, *broken, *find_implausible_samples(recording, robot))
    doubts = (mixed,) if mixed else doubts
    return recording, doubts


def _mask_rows(
    signals: Mapping[str, Array], rows: Array, robot: Robot, driven: bool
) -> tuple[Array, Array, int]:
    """Return the kept rows, which of them are masked, and the number left out.

    Samples that are not numbers are left out, and the interval between their neighbours
    is masked. The bus of an arm with drives also flips bits: isolated jumps are left
    out. A goal beyond the range of its joint is masked: a stop carries the arm.

    Args:
        rows: Rows in which every signal is a number. Shape (n,).

    Returns:
        Shapes (n,), (kept rows, dof), and how many samples are left out.
    """
    q, keep = signals["q"], rows.copy()
    masked = np.zeros(q.shape, bool)
    if driven:
        keep[np.flatnonzero(rows)[find_leaps(q[rows])]] = False
        goal = signals["q_ref"]
        with np.errstate(invalid="ignore"):
            masked |= (goal < robot.lower) | (goal > robot.upper)
    masked |= (~keep | ~np.r_[keep[1:], True] | ~np.r_[True, keep[:-1]])[:, None]
    return keep, masked[keep], int(np.sum(~keep))


def _rows(keep: Array) -> slice | Array:
    """Return the indices of the kept rows; a slice, without a copy, for all rows."""
    return slice(None) if keep.all() else np.flatnonzero(keep)
