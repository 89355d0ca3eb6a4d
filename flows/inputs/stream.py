"""Samples that are still coming: from a file that grows, or from standard input."""

import hashlib
import json
import os
import select as selecting
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
    """What has come since the last look."""

    samples: Samples | None = None  # samples in their order; None for none
    notes: tuple[str, ...] = ()  # what there is to say, a line each
    more: bool = False  # whether to look again at once


@dataclass(frozen=True, eq=False, slots=True)
class Reader:
    """What the lines of one table mean."""

    robot: Robot
    columns: ColumnMap  # the user's map
    names: tuple[str, ...]  # names of the table's columns
    chosen: Selection  # which of them are read
    separator: str  # between two values; empty for JSON

    def samples(self, lines: Sequence[str]) -> Samples:
        """Return lines as samples, NaN where a value is missing or no number."""
        rows = np.array([[_number(v) for v in self._values(line)] for line in lines])
        at = {name: i for i, name in enumerate(self.names)}
        t = rows[:, at[self.chosen.time]]
        t = t * (TIME_UNITS[self.columns.time_unit] * self.columns.time_scale)
        signals = {}
        for name in _LISTS:
            signal = self.chosen.signals[name]
            raw = rows[:, [at[column] for column in signal.columns]]
            with np.errstate(over="ignore", invalid="ignore"):
                signals[name] = to_link_side(name, raw, signal, self.robot)
        return Samples(t, signals["q"], signals["tau"])

    def _values(self, line: str) -> Sequence[object]:
        if not self.separator:
            values = _flat(line) or {}
            return [values.get(name) for name in self.names]
        words = split(line, self.separator)
        if len(words) != len(self.names):
            return [None] * len(self.names)
        comma = self.columns.csv.decimal == ","
        return [word.replace(",", ".") for word in words] if comma else words


def reader_of(line: str, robot: Robot, columns: ColumnMap, where: str) -> Reader:
    """Return what the lines after a first one mean."""
    if _is_json(line):
        values = _flat(line)
        if values is None:
            raise InputError(
                f'{where}: no JSON object, expected lines such as {{"t": 0.004, '
                '"q": [..], "tau": [..]}.'
            )
        names, separator = tuple(values), ""
    else:
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
class Lines:
    """Bytes that become samples: whole lines, of which the first has the names."""

    name: str  # what they are read from
    robot: Robot
    columns: ColumnMap
    header: str | None = None  # the line of names, None before it was read
    rest: bytes = b""  # what has come of a line without an end
    skips: bool = False  # whether that line is too long, and left out
    reader: Reader | None = None

    def take(self, new: bytes) -> Batch:
        """Return what the lines say that are whole now."""
        text, notes = self.rest + new, ()
        if self.skips:
            _, end, text = text.partition(b"\n")
            self.skips = not end
        whole, end, self.rest = text.rpartition(b"\n")
        samples = self._samples((whole + end).decode("utf-8-sig", errors="replace"))
        if len(self.rest) >= _AT_ONCE:
            if self.header is None:
                raise InputError(
                    f"{self.name}: its line of names has more than {_AT_ONCE} bytes. "
                    "Expected names such as t,q1,tau1."
                )
            words = f"a line of more than {_AT_ONCE} bytes was left out"
            notes = () if self.skips else (f"{self.name}: {words}: no row has so many",)
            self.skips = True
        if self.skips:
            self.rest = b""
        return Batch(samples, notes)

    def _samples(self, text: str) -> Samples | None:
        lines = [line.rstrip("\r") for line in text.split("\n") if line.strip()]
        if self.header is None and lines:
            self.header = lines[0]
            # The first JSON object has names and values.
            lines = lines if _is_json(lines[0]) else lines[1:]
        if self.reader is None and self.header is not None:
            self.reader = reader_of(self.header, self.robot, self.columns, self.name)
        return self.reader.samples(lines) if lines and self.reader else None


class GrowingFile:
    """A text file that somebody writes; it need not be there yet.

    Attributes:
        offset: Bytes that were read.
        ended: Never: somebody may always write more.
    """

    ended = False

    def __init__(
        self, path: Path, robot: Robot, columns: ColumnMap, position: dict | None = None
    ) -> None:
        """Read on at the place where it was left; None for its begin."""
        if path.is_dir():
            raise InputError(f"{path} is a folder, expected a file.")
        self.path, self.name, self.offset = path, path.name, 0
        self._lines = Lines(path.name, robot, columns)
        self._known = ("", 0)  # hash of its first bytes, and how many they are
        if position and position.get("file") == path.name:
            self.offset, self._lines.header = position["read"], position["header"]
            self._known = (position["known"][0], position["known"][1])

    def position(self) -> dict:
        """Return where to go on."""
        place = {"file": self.name, "read": self.offset}
        return place | {"header": self._lines.header, "known": list(self._known)}

    def read(self) -> Batch:
        """Return the lines that were completed since the last look."""
        try:
            with self.path.open("rb") as file:
                notes = self._anew(file)
                file.seek(self.offset)
                text = file.read(_AT_ONCE)
                if self._known[1] < _FIRST:
                    size = min(file.seek(0, 2), _FIRST)
                    self._known = (_hash(file, size), size)
        except FileNotFoundError:
            return Batch()
        except OSError as error:
            raise InputError(f"Cannot read {self.path}: {error.strerror}.") from error
        batch = self._lines.take(text)
        self.offset += len(text) - len(self._lines.rest)
        self._lines.rest = b""  # it is read again, whole
        more = len(text) == _AT_ONCE
        return replace(batch, notes=(*notes, *batch.notes), more=more)

    def wait(self) -> None:
        """Wait a moment."""
        time.sleep(POLL)

    def _anew(self, file) -> tuple[str, ...]:
        """Begin again where the file is another one, or shorter; say so."""
        size = file.seek(0, 2)
        same = size >= self.offset and _hash(file, self._known[1]) == self._known[0]
        if same or not self.offset:
            return ()
        how = "shorter than what was read of it" if size < self.offset else "another"
        self.offset, self._known = 0, ("", 0)
        self._lines = Lines(self.name, self._lines.robot, self._lines.columns)
        return (f"{self.name} is {how}: it was replaced, and is read from its begin",)


def _hash(file, size: int) -> str:
    if not size:
        return ""
    file.seek(0)
    return hashlib.sha256(file.read(size)).hexdigest()[:16]


class StandardInput:
    """Lines that another program sends down a pipe.

    Attributes:
        ended: Whether the other program has closed its end.
    """

    name = "standard input"

    def __init__(self, robot: Robot, columns: ColumnMap) -> None:
        self._lines = Lines(self.name, robot, columns)
        self.ended = False

    def position(self) -> dict:
        """Return nothing: what was sent is not sent again."""
        return {}

    def read(self) -> Batch:
        """Return the lines that have come; never waits."""
        source = sys.stdin.fileno()
        if self.ended or not selecting.select([source], [], [], 0)[0]:
            return Batch()
        new = os.read(source, _AT_ONCE)
        if new:
            return replace(self._lines.take(new), more=True)
        self.ended = True
        lost = f"{self.name} ended in the middle of a line, which is left out"
        return Batch(notes=(lost,) if self._lines.rest else ())

    def wait(self) -> None:
        """Wait until something comes, for a moment at most."""
        selecting.select([sys.stdin.fileno()], [], [], POLL)


def _is_json(line: str) -> bool:
    return line.lstrip().startswith("{")


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
