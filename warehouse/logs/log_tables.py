"""Parquet logs, and text logs with any separator and with lines above the table.

RobotStudio's viewers of signals, and those of other makers, write lines about the
recording, a line of names, and often the unit of every signal: in brackets behind its
name or in a line below the names. The table is found by its shape. Stated units are
only compared with those of the map; a difference is an error.
"""

import csv
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pyarrow import csv as arrow_csv

from residual.errors import InputError
from residual.recording import Array
from warehouse.logs.column_map import CsvFormat

# The time of recording comes from the content: copying changes the date of the file.
# Range of plausible times.
_EARLIEST, _LATEST = datetime(2000, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC)
_STAMP = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?\s?(Z|[+-]\d\d:?\d\d)?")
FIELD = "recorded_at"  # keys in the metadata of a Parquet file


def convert_epoch_seconds(seconds: float) -> datetime | None:
    """Return the moment of a clock of seconds since 1970, UTC; None where it counts otherwise."""
    if not _EARLIEST.timestamp() <= seconds < _LATEST.timestamp():
        return None
    return datetime.fromtimestamp(seconds, UTC)


def find_header_timestamp(lines: Iterable[str]) -> tuple[datetime | None, str | None]:
    """Return the first time in lines above a table, UTC; or one without a zone."""
    for line in lines:
        if stamp := _STAMP.search(line):
            moment = _parsed(stamp[0])
            return (moment, None) if moment else (None, stamp[0])
    return None, None


def parse_timestamp(text: str) -> datetime:
    """Return a time given by the user, in ISO 8601 with a zone."""
    moment = _parsed(text)
    if moment is None or not _EARLIEST <= moment < _LATEST:
        raise InputError(
            f"--recorded-at '{text[:40]}': expected a date with time and zone, such as "
            "2026-11-20T14:03:00+01:00, or with Z for UTC."
        )
    return moment


def format_timestamp(moment: datetime | None) -> str | None:
    """Return a time in the form of records: ISO 8601 in UTC, None for none."""
    if moment is None:
        return None
    return moment.astimezone(UTC).isoformat().replace("+00:00", "Z")


def _parsed(text: str) -> datetime | None:
    try:
        moment = datetime.fromisoformat(text.strip().replace(",", "."))
    except ValueError:
        return None
    return moment.astimezone(UTC) if moment.tzinfo else None


class LogFile(ABC):
    """An opened log file.

    Attributes:
        name: File name, as messages begin.
        columns: Names of all columns.
        units: Units that the file itself states, by column.
        text: Columns that hold no numbers.
        notes: Remarks on the file, in words.
        recorded_at: Time of its first sample, UTC; None if unknown.
    """

    name: str
    columns: tuple[str, ...]
    units: Mapping[str, str] = {}
    text: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    recorded_at: datetime | None = None

    @abstractmethod
    def read(self, columns: tuple[str, ...]) -> dict[str, Array]:
        """Return the values of some columns, NaN where empty."""


HEAD = 1 << 16  # bytes in which the names of a file's columns must end
_SEPARATORS = ";\t,|"

# Units of a map, and their spellings.
_WRITTEN = {
    "s": ("s", "sec"),
    "ms": ("ms",),
    "us": ("us", "µs"),
    "rad": ("rad",),
    "deg": ("deg", "degrees", "grad", "°"),
    "rad/s": ("rad/s",),
    "deg/s": ("deg/s", "°/s"),
    "rad/s^2": ("rad/s^2", "rad/s2", "rad/s²"),
    "deg/s^2": ("deg/s^2", "deg/s2", "°/s²"),
    "N m": ("nm", "n m", "n·m", "n*m"),
    "N mm": ("nmm", "n mm", "n·mm", "n*mm"),
    "A": ("a",),
    "%": ("%",),
}
UNITS = {word: unit for unit, words in _WRITTEN.items() for word in words}
_COMMA = re.compile(r"[-+]?\d+,\d+(e[-+]?\d+)?", re.IGNORECASE)
_BRACKET = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")
# Largest number of lines above the samples.
_ABOVE = 60
_WINDOW = 9  # rows that show which columns hold numbers
BATCH = 1 << 16  # rows
# Noise of measured torques takes more than a byte per row, however compressed: a file
# with more rows than bytes is artificial. Up to a million rows are read at once.
_MOST_ROWS = 1_000_000


@dataclass(frozen=True, slots=True)
class TextTableLayout:
    """Where the table in a text file is."""

    names: tuple[str, ...]  # of the columns
    line: int  # where they stand, counted from 0
    samples: int  # first line with samples
    separator: str  # separator of columns
    # Units that the file states, by name.
    units: Mapping[str, str] = field(default_factory=dict)
    text: frozenset[str] = frozenset()  # columns whose first value is not a number
    above: int = 0  # number of lines above the names


class CsvLog(LogFile):
    """A text file with a line of names."""

    def __init__(self, path: Path, head: bytes, form: CsvFormat) -> None:
        self.name = path.name
        self._path = path
        self._form = form
        self._encoding, text = _decode(head)
        lines = re.split(r"\r\n|\n|\r", text)
        rows = [i for i, line in enumerate(lines) if i >= form.skip and line.strip()]
        if not rows:
            raise InputError(f"{self.name} has no line of column names after {form.skip} lines.")
        layout = find_text_table(lines, form)
        if layout is None:
            separator = form.separator or guess_separator(lines[rows[0]])
            names = split_csv_line(lines[rows[0]], separator)
            layout = TextTableLayout(tuple(map(str.strip, names)), rows[0], rows[0] + 1, separator)
        self._skip, self._separator = layout.samples, layout.separator
        if layout.line == len(lines) - 1 and len(head) >= HEAD:
            raise InputError(
                f"{self.name}: its line of column names is longer than {HEAD} "
                "bytes. Give a file with readable names."
            )
        self.columns, self.text = layout.names, layout.text
        self.units = layout.units
        self.recorded_at, unzoned = find_header_timestamp(lines[: layout.line])
        stated = ", ".join(f"{name}: {unit}" for name, unit in layout.units.items())
        notes = {
            f"{unzoned} has no time zone and is not used; see --recorded-at": unzoned,
            f"{layout.above} lines above the names": layout.above,
            f"units as the file says ({stated})": stated,
        }
        self.notes = tuple(text for text, present in notes.items() if present)
        filled = [name for name in self.columns if name]
        if 2 * sum(map(is_number, filled)) > len(filled):
            raise InputError(
                f"{self.name} starts with numbers, expected a line of column names "
                "such as t,q1,tau1. `ros2 topic echo --csv` writes none: add it."
            )

    def read(self, columns: tuple[str, ...]) -> dict[str, Array]:
        """Return the values of some columns, NaN where empty."""
        # Columns are found by position, since ignored ones may share a name.
        places = [str(i) for i in range(len(self.columns))]
        selected = [places[self.columns.index(column)] for column in columns]
        try:
            table = self._table(places, selected, threads=True)
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
            try:  # again, single-threaded: only then the parser counts lines
                table = self._table(places, selected, threads=False)
            except (pa.ArrowException, OSError, UnicodeDecodeError) as again:
                raise InputError(self._explain(str(again))) from error
        values = {}
        for column, place in zip(columns, selected, strict=True):
            values[column] = table.column(place).to_numpy()
            # Else a long log would be in memory twice.
            table = table.drop_columns([place])
        return values

    def _table(self, places: list[str], selected: list[str], threads: bool) -> pa.Table:
        return arrow_csv.read_csv(
            prepare_arrow_source(self._path),
            read_options=arrow_csv.ReadOptions(
                skip_rows=self._skip,
                column_names=places,
                encoding=self._encoding,
                use_threads=threads,
            ),
            parse_options=arrow_csv.ParseOptions(delimiter=self._separator),
            convert_options=arrow_csv.ConvertOptions(
                include_columns=selected,
                column_types=dict.fromkeys(selected, pa.float64()),
                decimal_point=self._form.decimal,
            ),
        )

    def _explain(self, error: str) -> str:
        """Turn an error of the parser into advice for the user."""
        row = re.search(r"Row #(\d+)", error)
        line = f"line {row[1]}" if row else "a line"
        if match := re.search(r"column #(\d+).*invalid value '(.*)'", error):
            place, value = int(match[1]), match[2][:30]
            at = f"{line}: " if row else ""
            cell = f"{self.name}: {at}column '{self.columns[place]}' has '{value}'"
            if _COMMA.fullmatch(value.strip()):
                return f"{cell}.\nDecimal comma? Say so in --map: csv = {{decimal = ','}}."
            return f"{cell}, expected a number."
        if match := re.search(r"Expected (\d+) columns, got (\d+)", error):
            return (
                f"{self.name}: {line} has {match[2]} values for {match[1]} names. "
                "Repair it, or give the separator in --map: csv = {separator = ';'}."
            )
        if "too short" in error or "Empty CSV" in error:
            return f"{self.name} has names but no samples."
        return f"{self.name} is not a readable CSV file: {error.splitlines()[0][:120]}"


def guess_csv_format(path: Path) -> CsvFormat:
    """Return the format of a text file: whether its numbers have a decimal comma.

    Separators and lines above the names are found wherever a file is read.
    """
    with path.open("rb") as file:
        _, text = _decode(file.read(HEAD))
    lines = re.split(r"\r\n|\n|\r", text)
    layout = find_text_table(lines, CsvFormat())
    if layout is None:
        return CsvFormat()
    fields = [
        f for line in lines[layout.samples : -1] for f in split_csv_line(line, layout.separator)
    ]
    comma = sum(bool(_COMMA.fullmatch(field.strip())) for field in fields)
    point = sum("." in field and is_number(field) for field in fields)
    return CsvFormat(decimal="," if comma > point else ".")


def _decode(head: bytes) -> tuple[str, str]:
    # The cut may fall inside a character; use the text up to the last line end.
    lines = head[: head.rfind(b"\n") + 1] or head
    try:
        return "utf-8", lines.decode("utf-8-sig")
    except UnicodeDecodeError:
        return "latin-1", lines.decode("latin-1")


def guess_separator(header: str) -> str:
    """Return the separator that splits the names into the most."""
    best = max(_SEPARATORS, key=lambda s: len(split_csv_line(header, s)))
    # A blank is a separator only if nothing else is: names may contain blanks.
    return best if best in header else " "


def split_csv_line(line: str, separator: str) -> list[str]:
    """Return the fields of a line; the whole line if a field is too long."""
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return [line]


def is_number(text: str) -> bool:
    """Whether a text is a number, with a decimal point or comma."""
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def find_text_table(lines: Sequence[str], form: CsvFormat) -> TextTableLayout | None:
    """Find the table in the first lines of a file; None if there is none.

    Its first row has two or more numbers, most of the rows below have as many fields
    and numbers in the same columns, and the line above has as many names.
    """
    rows = [i for i, line in enumerate(lines) if i >= form.skip and line.strip()]
    separators = form.separator or f"{_SEPARATORS} "
    for place in range(1, min(len(rows), _ABOVE + 1)):
        window = [lines[i] for i in rows[place : place + _WINDOW]]
        best: TextTableLayout | None = None
        most = 1
        for separator in separators:
            samples = [split_csv_line(line, separator) for line in window]
            numeric = _numeric_columns(samples)
            if len(numeric) > most and (
                layout := _layout(lines, rows[: place + 1], separator, samples, numeric)
            ):
                best, most = layout, len(numeric)
        if best:
            return best
    return None


def _numeric_columns(samples: list[list[str]]) -> list[int]:
    """Columns with a number in a row and in most of those below; [] for no table."""
    fields, *below = samples
    numeric = [k for k, field in enumerate(fields) if is_number(field)]
    alike = [
        row
        for row in below
        if len(row) == len(fields) and all(is_number(row[k]) or not row[k].strip() for k in numeric)
    ]
    return numeric if 2 * len(alike) >= len(below) else []


def _layout(
    lines: Sequence[str],
    rows: Sequence[int],
    separator: str,
    samples: list[list[str]],
    numeric: list[int],
) -> TextTableLayout | None:
    """Return the table whose samples begin in the last of some rows; None for none."""
    stated: list[str] = []
    fields = samples[0]
    least = len(_clean(fields))
    for place in range(len(rows) - 2, -1, -1):
        if not lines[rows[place]].strip(f"-=_+:|{separator} "):
            continue  # a rule between names and samples
        names = split_csv_line(lines[rows[place]], separator)
        if lines[rows[place]].startswith("#") and len(names) == len(fields) + 1:
            names = names[1:]
        names[0] = names[0].removeprefix("#").strip()
        at = [names[k].strip() for k in numeric if k < len(names)]
        if place and not stated and _are_units(at):
            stated = [word.strip().strip("[]()") for word in names]
            continue
        names = _clean(names)
        if not least <= len(names) <= len(fields) or any(map(is_number, at)):
            return None
        units = {n: u for n, u in zip(names, stated, strict=False) if u}
        for name in names:
            if bracket := _BRACKET.search(name):
                units.setdefault(name, bracket[1].strip())
        names += [""] * (len(fields) - len(names))
        return TextTableLayout(
            names=tuple(names),
            line=rows[place],
            samples=rows[-1],
            separator=separator,
            units={n: UNITS[u.lower()] for n, u in units.items() if u.lower() in UNITS},
            text=frozenset(
                name
                for k, name in enumerate(names)
                if not any(is_number(row[k]) for row in samples if k < len(row))
            ),
            above=place,
        )
    return None


def _clean(fields: list[str]) -> list[str]:
    """Return names without blanks, and without an empty last name."""
    fields = [field.strip().strip('"') for field in fields]
    while fields and not fields[-1]:
        fields.pop()
    return fields


def _are_units(fields: list[str]) -> bool:
    units = sum(field.strip("[]() ").lower() in UNITS for field in fields)
    plain = sum(field.strip("[]() ") in ("", "-", "1") for field in fields)
    return units > 0 and 2 * (units + plain) > len(fields)


class ParquetLog(LogFile):
    """A Parquet file."""

    def __init__(self, path: Path) -> None:
        self.name = path.name
        try:
            # With read-ahead, the file itself would be in memory too.
            self._file = pq.ParquetFile(prepare_arrow_source(path), pre_buffer=False)
        except (pa.ArrowException, OSError) as error:
            raise InputError(_broken(path.name)) from error
        rows, size = self._file.metadata.num_rows, path.stat().st_size
        if rows > max(_MOST_ROWS, size):
            raise InputError(
                f"{path.name} has {size} bytes but claims {rows} rows, expected "
                "several bytes per measured sample. Export the log again."
            )
        self._schema = self._file.schema_arrow
        # Column and index in its lists; None for a column of numbers. Arrow finds neither
        # of two columns with one name; `select_columns` refuses such a name.
        self._places: dict[str, tuple[pa.Field, int | None]] = {}
        names: list[str] = []
        times = Counter(self._schema.names)
        for each in self._schema:
            size = self._lengths(each) if times[each.name] == 1 else None
            items = {f"{each.name}[{k}]": (each, k) for k in range(size or 0)}
            items = items or {each.name: (each, None)}
            names += items
            self._places |= items
        self.columns = tuple(names)
        self.text = frozenset(
            c for c, (each, k) in self._places.items() if not _holds_numbers(each.type, k)
        )
        recorded = (self._schema.metadata or {}).get(FIELD.encode(), b"")
        self.recorded_at, _ = find_header_timestamp([recorded.decode(errors="replace")])

    def read(self, columns: tuple[str, ...]) -> dict[str, Array]:
        """Return the values of some columns, NaN where empty."""
        for column in columns:
            if column in self.text:
                kind = self._places[column][0].type
                raise InputError(
                    f"{self.name}: column '{column}' holds {kind}, expected numbers. Export it "
                    "as numbers, a time as seconds, or name another column in the map (--map)."
                )
        values = {c: np.empty(self._file.metadata.num_rows) for c in columns}
        done = 0
        try:
            # Batch by batch: the full table would be in memory beside the values.
            selected = list(dict.fromkeys(self._places[c][0].name for c in columns))
            for batch in self._file.iter_batches(BATCH, columns=selected):
                rows = slice(done, done + len(batch))
                for c in columns:
                    each, k = self._places[c]
                    column = batch.column(each.name)
                    if k is not None:
                        column = self._items(column, each.name, k)
                    # The last hundred nanoseconds of a clock do not matter.
                    column = column.cast(pa.float64(), safe=False)
                    values[c][rows] = column.to_numpy(zero_copy_only=False)
                done += len(batch)
        except (pa.ArrowException, OSError) as error:
            raise InputError(_broken(self.name)) from error
        return {c: x[:done] for c, x in values.items()}

    def _items(self, column: pa.Array, name: str, k: int) -> pa.Array:
        try:
            return pc.list_element(column, k)
        except pa.ArrowInvalid as error:
            raise InputError(
                f"{self.name}: lists of column '{name}' differ in length, expected as many "
                "numbers in every row. Repair the log or cut it with a window (FILE@start:end)."
            ) from error

    def _lengths(self, field: pa.Field) -> int | None:
        """Return the length of the lists of a column; None if it has no lists."""
        if pa.types.is_fixed_size_list(field.type):
            return field.type.list_size
        lists = pa.types.is_list(field.type) or pa.types.is_large_list(field.type)
        if not lists or not self._file.metadata.num_rows:
            return None
        try:
            batch = next(self._file.iter_batches(1, columns=[field.name]))
        except (pa.ArrowException, OSError) as error:
            raise InputError(_broken(self.name)) from error
        return len(batch.column(0)[0].as_py() or ())


def _holds_numbers(kind: pa.DataType, place: int | None) -> bool:
    """Whether a column holds numbers, or lists of numbers of which one is read."""
    kind = kind if place is None else kind.value_type
    return pa.types.is_integer(kind) or pa.types.is_floating(kind)


def prepare_arrow_source(path: Path) -> Path | pa.BufferReader:
    """Return a source for Arrow: the bytes of a file whose name is not UTF-8."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return pa.BufferReader(path.read_bytes())
    return path


def _broken(name: str) -> str:
    return f"{name} is not a readable Parquet file. Export the log again."
