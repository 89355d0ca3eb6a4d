"""Samples that are still coming: from a file that grows, or from standard input."""

import hashlib
import json
import os
import select as selecting
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from residual.errors import InputError
from residual.monitoring.rows import Samples
from residual.robot.robot import Robot
from warehouse.logs.columns import (
    TIME_UNITS,
    ColumnMap,
    Selection,
    select,
    to_link_side,
)
from warehouse.logs.tables import is_number, sniff, split

POLL = 0.2  # s between two looks
_AT_ONCE = 1 << 20  # bytes
_FIRST = 256  # bytes by which a file is known again
_LISTS = ("q", "tau")


@dataclass(frozen=True, eq=False, slots=True)
class Batch:
    """What has come since the last look.

    Attributes:
        samples: Samples in their order; None for none.
        notes: What there is to say, a line each.
        more: Whether to look again at once.
    """

    samples: Samples | None = None
    notes: tuple[str, ...] = ()
    more: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class Reader:
    """What the lines of one table mean.

    Attributes:
        robot: The arm.
        columns: The user's map.
        names: Names of the table's columns.
        chosen: Which of them are read.
        separator: Between two values; empty for JSON.
    """

    robot: Robot
    columns: ColumnMap
    names: tuple[str, ...]
    chosen: Selection
    separator: str

    def samples(self, lines: Sequence[str]) -> Samples:
        """Return lines as samples, NaN where a value is missing or no number."""
        rows = self._from_json(lines) if not self.separator else self._table(lines)
        at = {name: i for i, name in enumerate(self.names)}
        t = rows[:, at[self.chosen.time]]
        t = t * (TIME_UNITS[self.columns.time_unit] * self.columns.time_scale)
        made = {}
        for name in _LISTS:
            signal = self.chosen.signals[name]
            raw = rows[:, [at[column] for column in signal.columns]]
            with np.errstate(over="ignore", invalid="ignore"):
                made[name] = to_link_side(name, raw, signal, self.robot)
        return Samples(t, made["q"], made["tau"])

    def _table(self, lines: Sequence[str]) -> np.ndarray:
        comma = self.columns.csv.decimal == ","
        out = np.full((len(lines), len(self.names)), np.nan)
        for i, line in enumerate(lines):
            values = split(line, self.separator)
            if len(values) == len(self.names):
                out[i] = [_number(v.replace(",", ".") if comma else v) for v in values]
        return out

    def _from_json(self, lines: Sequence[str]) -> np.ndarray:
        out = np.full((len(lines), len(self.names)), np.nan)
        for i, line in enumerate(lines):
            values = _flat(line) or {}
            out[i] = [_number(values.get(name)) for name in self.names]
        return out


def reader_of(line: str, robot: Robot, columns: ColumnMap, where: str) -> Reader:
    """Return what the lines after a first one mean."""
    if line.lstrip().startswith("{"):
        values = _flat(line)
        if values is None:
            raise InputError(
                f'{where}: no JSON object, expected lines such as {{"t": 0.004, '
                '"q": [..], "tau": [..]}.'
            )
        names = tuple(values)
        return Reader(
            robot, columns, names, select(names, columns, robot.dof, where), ""
        )
    separator = columns.csv.separator or sniff(line)
    names = tuple(name.strip() for name in split(line, separator))
    if all(is_number(name) for name in names):
        raise InputError(
            f"{where} starts with numbers, expected a line of column names such as "
            "t,q1,tau1."
        )
    chosen = select(names, columns, robot.dof, where)
    return Reader(robot, columns, names, chosen, separator)


@dataclass(slots=True)
class GrowingFile:
    """A text file that somebody writes.

    Attributes:
        path: The file; it need not be there yet.
        robot: The arm.
        columns: Which column is what.
        offset: Bytes that were read.
        header: Its line of names, None before it was read.
        known: Hash of its first bytes, and how many they are.
    """

    path: Path
    robot: Robot
    columns: ColumnMap
    offset: int = 0
    header: str | None = None
    known: tuple[str, int] = ("", 0)
    _reader: Reader | None = field(default=None, repr=False)
    _skips: bool = field(default=False, repr=False)  # in a line that is left out

    @classmethod
    def at(
        cls, path: Path, robot: Robot, columns: ColumnMap, position: dict | None
    ) -> "GrowingFile":
        """Return the file, at the place where it was left; None for its begin."""
        if path.is_dir():
            raise InputError(f"{path} is a folder, expected a file.")
        if not position or position.get("file") != path.name:
            return cls(path, robot, columns)
        known = (position["known"][0], position["known"][1])
        place = position["read"], position["header"], known
        return cls(path, robot, columns, *place)

    ended = False  # somebody may always write more

    @property
    def name(self) -> str:
        """Its name."""
        return self.path.name

    def position(self) -> dict:
        """Return where to go on."""
        place = {"file": self.path.name, "read": self.offset}
        return place | {"header": self.header, "known": list(self.known)}

    def read(self) -> Batch:
        """Return the lines that were completed since the last look."""
        try:
            with self.path.open("rb") as file:
                note = self._anew(file)
                file.seek(self.offset)
                text = file.read(_AT_ONCE)
                self._remember(file)
        except FileNotFoundError:
            return Batch()
        except OSError as error:
            raise InputError(f"Cannot read {self.path}: {error.strerror}.") from error
        lines, used = whole_lines(text)
        more = len(text) == _AT_ONCE
        if self._skips and used:  # the end of a line of which the begin is left out
            lines, used, more = [], text.index(b"\n") + 1, True
            self._skips = False
        elif not used and more:
            note = (*note, *_left_out(self.name, self.header, self._skips))
            used, self._skips = len(text), True
        self.offset += used
        lines = self._without_names(lines)
        if not lines or self._reader is None:
            return Batch(notes=note, more=more)
        return Batch(self._reader.samples(lines), note, more)

    def unfinished(self) -> bool:
        """Whether a last line has no end yet."""
        try:
            return self.path.stat().st_size > self.offset
        except OSError:
            return False

    def wait(self) -> None:
        """Wait a moment."""
        time.sleep(POLL)

    def _without_names(self, lines: list[str]) -> list[str]:
        if self.header is None and lines:
            first = lines[0]
            self.header = first
            # The first JSON object has names and values.
            lines = lines if first.lstrip().startswith("{") else lines[1:]
        if self._reader is None and self.header is not None:
            self._reader = reader_of(self.header, self.robot, self.columns, self.name)
        return lines

    def _anew(self, file) -> tuple[str, ...]:
        """Begin again where the file is another one, or shorter; say so."""
        size = file.seek(0, 2)
        same = size >= self.offset and _hash(file, self.known[1]) == self.known[0]
        if same or not self.offset:
            return ()
        how = "shorter than what was read of it" if size < self.offset else "another"
        self.offset, self.header, self._reader, self.known = 0, None, None, ("", 0)
        self._skips = False
        return (f"{self.name} is {how}: it was replaced, and is read from its begin",)

    def _remember(self, file) -> None:
        if self.known[1] < _FIRST:
            size = min(file.seek(0, 2), _FIRST)
            self.known = (_hash(file, size), size)


def _hash(file, size: int) -> str:
    if not size:
        return ""
    file.seek(0)
    return hashlib.sha256(file.read(size)).hexdigest()[:16]


@dataclass(slots=True)
class StandardInput:
    """Lines that another program sends down a pipe.

    Attributes:
        robot: The arm.
        columns: Which column is what.
        ended: Whether the other program has closed its end.
        buffer: What has come of a line without an end.
    """

    robot: Robot
    columns: ColumnMap
    ended: bool = False
    buffer: bytes = b""
    name: str = "standard input"
    _reader: Reader | None = field(default=None, repr=False)
    _skips: bool = field(default=False, repr=False)

    def position(self) -> dict:
        """Return nothing: what was sent is not sent again."""
        return {}

    def read(self) -> Batch:
        """Return the lines that have come; never waits."""
        source = sys.stdin.fileno()
        if self.ended or not selecting.select([source], [], [], 0)[0]:
            return Batch()
        new = os.read(source, _AT_ONCE)
        if not new:
            self.ended = True
            lost = f"{self.name} ended in the middle of a line, which is left out"
            return Batch(notes=(lost,) if self.buffer else ())
        text, notes = self.buffer + new, ()
        if self._skips:
            text = text.partition(b"\n")[2]
            self._skips = b"\n" not in new
        lines, used = whole_lines(text)
        self.buffer = text[used:]
        if len(self.buffer) > _AT_ONCE:
            notes = _left_out(self.name, self._reader, skips=False)
            self.buffer, self._skips = b"", True
        if lines and self._reader is None:
            self._reader = reader_of(lines[0], self.robot, self.columns, self.name)
            lines = lines if lines[0].lstrip().startswith("{") else lines[1:]
        if not lines or self._reader is None:
            return Batch(notes=notes, more=True)
        return Batch(self._reader.samples(lines), notes, more=True)

    def wait(self) -> None:
        """Wait until something comes, for a moment at most."""
        selecting.select([sys.stdin.fileno()], [], [], POLL)


def _left_out(name: str, names: object, skips: bool) -> tuple[str, ...]:
    """Return what to say of a line that is too long; nothing in the midst of it."""
    if names is None:
        raise InputError(
            f"{name}: its line of names has more than {_AT_ONCE} bytes. Expected names "
            "such as t,q1,tau1."
        )
    words = f"a line of more than {_AT_ONCE} bytes was left out: no row has so many"
    return () if skips else (f"{name}: {words}",)


def whole_lines(text: bytes) -> tuple[list[str], int]:
    """Return the lines that have an end, and how many bytes they are."""
    end = text.rfind(b"\n") + 1
    lines = text[:end].decode("utf-8-sig", errors="replace").split("\n")
    return [line.rstrip("\r") for line in lines if line.strip()], end


def _flat(line: str) -> Mapping | None:
    """A JSON object with its lists as q1, q2, ...; None where it is none."""
    try:
        given = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(given, dict):
        return None
    out = {}
    for name, value in given.items():
        if isinstance(value, list):
            out |= {f"{name}{k}": v for k, v in enumerate(value, start=1)}
        else:
            out[name] = value
    return out


def _number(value: object) -> float:
    try:
        return float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError):
        return float("nan")
