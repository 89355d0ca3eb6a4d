"""Records, logs and answers of the store as text: tables for people, CSV and JSON."""

import csv
import io
import json
import math
import sys
from collections import Counter
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import asdict
from datetime import datetime
from decimal import Decimal

import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.markup import escape
from rich.tree import Tree

from flows.report import ReportTable, build_text_table, print_parts, widen_piped_console
from residual.errors import InputError, strip_control_characters
from warehouse.sql_guard import NAMED, TAKES
from warehouse.view_schema import list_views

_SHOWN = 40  # lines of one table
_LISTED = 12  # channels of a rerun that are listed for people


def build_diff_tables(difference) -> list[str | ReportTable]:
    """Return a comparison of two records: which values differ, and by how much."""
    same = "the same values" if difference.same else "different values"
    parts = [f"{difference.kind} {difference.ids[0]} and {difference.ids[1]}: {same}"]
    for heading, rows in difference.tables.items():
        if not rows:
            parts.append(f"{heading}: identical")
            continue
        texts = (["–" if v is None else str(v) for v in row] for row in rows[:_SHOWN])
        shown = [[t if len(t) <= 64 else f"{t[:61]}..." for t in row] for row in texts]
        heads = (heading, *(id[:8] for id in difference.ids))
        parts.append(build_text_table(heads, shown))
        parts += _more(len(rows))
    if difference.kind != "runs":
        # Numbers of the record are in its table; files and tables are not.
        parts += [channel.words for channel in difference.channels[:_SHOWN]]
        return parts + _more(len(difference.channels))
    rows = []
    for c in difference.channels:
        count = str(c.differing) if c.differing or not c.note else c.note
        figures = ["–" if v is None else f"{v:.4g}" for v in (c.first, c.largest, c.rms)]
        differ = "equal" if c.equal else count
        rows.append((c.name, c.unit or "–", str(c.rows), differ, *figures))
    heads = ("channel", "unit", "samples", "differ", "from [s]", "largest", "rms")
    return [*parts, build_text_table(heads, rows)]


def build_diff_record(difference) -> dict:
    """Return a comparison as JSON can hold it."""
    tables = {
        heading: [{"name": n, "one": one, "two": two} for n, one, two in rows]
        for heading, rows in difference.tables.items()
    }
    return {
        "kind": difference.kind,
        "one": difference.ids[0],
        "two": difference.ids[1],
        "same": difference.same,
        **tables,
        "data": [asdict(channel) for channel in difference.channels],
    }


def print_tree(root, words: str, console: Console) -> None:
    """Print a record and its relatives."""

    def name(relative) -> str:
        return f"{relative.kind or 'not in this store'} {escape(relative.id)}"

    def grow(tree: Tree, root) -> None:
        for each in root.relatives:
            again = ", see above" if each.again else ""
            grow(tree.add(f"{escape(each.role)}: {name(each)}{again}"), each)

    tree = Tree(f"{name(root)}, {words}{'' if root.relatives else ': nothing'}")
    grow(tree, root)
    console.print(tree, highlight=False)


def _more(count: int) -> list[str]:
    remaining = count - _SHOWN
    return [f"and {remaining} more; --format json has all"] if remaining > 0 else []


_LONG = 200  # characters of a text beyond which a line shows its start


def format_record_lines(value: Mapping | list, indent: str = "") -> list[str]:
    """Return a nested record as lines: key, then its value or lines below it."""
    lines = []
    items = value.items() if isinstance(value, Mapping) else (("-", v) for v in value)
    for key, item in items:
        parts = item if isinstance(item, list) else [item]
        if any(isinstance(part, Mapping | list) and part for part in parts):
            lines += [
                strip_control_characters(f"{indent}{key}:"),
                *format_record_lines(item, indent + "  "),
            ]
        else:
            lines.append(strip_control_characters(f"{indent}{key}: {_value(item)}"))
    return lines


def _value(item: object) -> str:
    if isinstance(item, list):
        return ", ".join(_value(part) for part in item) or "–"
    text = "–" if item is None or item == {} else str(item)
    if len(text) <= _LONG:
        return text
    return f"{' '.join(text[:60].split())} … ({len(text)} characters, --format json)"


def describe_rerun(rerun) -> list[str]:
    """Return the result of a rerun, line by line."""
    about = f"{rerun.kind} {rerun.id}"
    if rerun.reproduced and rerun.imported:
        return [f"{about}: measured; its values match the import"]
    if rerun.reproduced:
        code = "" if rerun.same_code else "; the code has changed, the values have not"
        out = [f"{about}: identical bit for bit{code}"]
    else:
        out = [f"{about}: different"]
        out += [f"  {channel.words}" for channel in rerun.differences[:_LISTED]]
        if len(rerun.differences) > _LISTED:
            out.append(f"  and {len(rerun.differences) - _LISTED} more")
        out.append(f"most probable cause: {rerun.cause.kind}: {rerun.cause.why}")
    out.append(rerun.changes)
    if rerun.new_id:
        out.append(f"stored as its rerun: modelgap show {rerun.new_id}")
    if rerun.note_id:
        out.append(f"difference recorded: modelgap show {rerun.note_id}")
    return out


def build_rerun_record(rerun) -> Mapping:
    """Return the same as JSON can hold it."""
    keys = ["id", "kind", "reproduced", "same_code", "imported", "changes"]
    return {
        **{key: getattr(rerun, key) for key in keys},
        "made": rerun.new_id,
        "noted": rerun.note_id,
        "differences": [asdict(channel) for channel in rerun.differences],
        "cause": rerun.cause and asdict(rerun.cause),
    }


# The table stops here; the other formats have all rows.
MOST = 1000


def print_query_result(rows: pa.Table, format: str) -> None:
    """Print an answer on standard output, as table, csv, json or parquet.

    Raises:
        InputError: If JSON or Parquet would lose a column, two having one name.
    """
    if format in ("json", "parquet"):
        _check_names(rows, format)
    if format == "parquet":
        sys.stdout.buffer.write(encode_query_result(rows, format))
    elif format == "json":
        columns = [[_plain(cell.as_py()) for cell in column] for column in rows.columns]
        names = rows.column_names
        out = [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
        print(json.dumps(out, indent=2, ensure_ascii=False, allow_nan=False))
    elif format == "csv":
        writer = csv.writer(sys.stdout, lineterminator="\n")
        writer.writerow(rows.column_names)
        for batch in rows.to_batches(max_chunksize=10_000):
            columns = [[_field(cell.as_py()) for cell in column] for column in batch]
            writer.writerows(zip(*columns, strict=True))
    else:
        types = [field.type for field in rows.schema]
        number = [pa.types.is_integer(t) or pa.types.is_floating(t) for t in types]
        shown = rows.slice(0, MOST).columns
        cells = zip(*([_format_cell(c.as_py()) for c in column] for column in shown), strict=True)
        text_columns = [i for i, is_number in enumerate(number) if not is_number]
        more = f"; the first {MOST} are shown, --format csv has all"
        count = f"{len(rows)} row{'' if len(rows) == 1 else 's'}" + more * (len(rows) > MOST)
        # Into a file or a pipe: as wide as it needs, nothing is cut.
        table = ReportTable(rows.column_names, list(cells), text_columns=text_columns)
        print_parts(widen_piped_console(Console(), 10_000), table, count)


def encode_query_result(rows: pa.Table, format: str) -> bytes:
    """Return an answer as the content of a file, as `print_query_result` prints it."""
    if format == "parquet":
        _check_names(rows, format)
        sink = pa.BufferOutputStream()
        try:
            pq.write_table(rows, sink, compression="zstd")
        except pa.ArrowNotImplementedError as error:
            raise InputError(
                f"Parquet cannot hold a column of this answer: {error}. Cast it to "
                "text or a number: x::VARCHAR."
            ) from error
        return sink.getvalue().to_pybytes()
    text = io.StringIO()
    with redirect_stdout(text):
        print_query_result(rows, format)
    return text.getvalue().encode()


def refuse_binary_on_terminal(format: str, out: str | None) -> None:
    """Raise InputError for Parquet, without a file, on a terminal."""
    if format == "parquet" and out is None and sys.stdout.isatty():
        raise InputError(
            "Parquet is not text. Name a file with --out FILE, or redirect with > FILE."
        )


def _check_names(rows: pa.Table, format: str) -> None:
    counts = Counter(rows.column_names)
    twice = [name for name, count in counts.items() if count > 1]
    if twice:
        raise InputError(
            f"Two columns have the name '{twice[0]}': {format} would keep one of them. "
            f"Rename one: SELECT ... AS {twice[0]}_2."
        )


def _format_cell(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, datetime):
        return value.isoformat(" ", "seconds")
    if isinstance(value, list):
        return ", ".join(map(_format_cell, value))
    return str(value)


def _field(value: object) -> object:
    """One field of CSV: numbers in full, lists as JSON, empty for null."""
    if isinstance(value, list | dict):
        return json.dumps(_plain(value), ensure_ascii=False)
    return value.isoformat() if isinstance(value, datetime) else value


def _plain(value: object) -> object:
    """A value that JSON has; a number that is not finite becomes text: NaN, Infinity.

    JSON has no such numbers, and null says that there is no value.
    """
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        infinity = "Infinity" if value > 0 else "-Infinity"
        return "NaN" if math.isnan(value) else infinity
    if isinstance(value, Decimal):  # a sum of whole numbers is one
        if value == int(value):
            return int(value)
        return float(value) if Decimal(repr(float(value))) == value else str(value)
    if value is None or isinstance(value, str | int | float):
        return value
    return value.isoformat() if isinstance(value, datetime) else str(value)


def list_schema_columns() -> pa.Table:
    """Return every view and column with type, unit and meaning."""
    rows = [
        {
            "view": view,
            "column": column.name,
            "type": str(column.type),
            "unit": column.unit or "none",
            "about": column.about,
        }
        for view, columns in list_views().items()
        for column in columns
    ]
    return pa.Table.from_pylist(rows)


def list_named_queries() -> pa.Table:
    """Return the named queries with a sentence each, and their values."""
    rows = [
        {
            "--named": name,
            "answers": about,
            "--with": ", ".join(f"{k}=... ({v})" for k, v in describe_query_values(name).items()),
        }
        for name, (about, _) in NAMED.items()
    ]
    return pa.Table.from_pylist(rows)


def describe_query_values(name: str) -> Mapping[str, str]:
    """Return the values that a named query takes: their meaning by name."""
    return TAKES.get(name, {})
