"""modelgap sql."""

import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import pyarrow as pa
from cyclopts import Parameter

from flows.cli.app import STDOUT
from flows.outputs import check_outside, check_writable, write_all
from flows.report.answers import (
    as_bytes,
    check_shown,
    named_table,
    print_table,
    schema_table,
    tell_damage,
    values_of,
)
from flows.requests import File, Flag, Format, Json, Name, Seconds, Store, Tags
from flows.settings import store_folder
from residual.errors import InputError, check_name
from warehouse.query.guard import LONGEST
from warehouse.query.store import open_store
from warehouse.query.views import NAMED

_ONE_OF = 'Give one of: a query in quotes ("SELECT ..."), --named NAME, --schema.'


def sql(
    query: str | None = None,
    /,
    *,
    named: Name = None,
    with_: Annotated[Tags, Parameter(name="--with", metavar="KEY=VALUE")] = (),
    schema: Flag = False,
    format: Format = "table",
    out: File = None,
    json: Json = None,
    timeout: Seconds = 60.0,
    without_damaged: Flag = False,
    store: Store = None,
) -> None:
    """Query the store in SQL.

    ```
    modelgap sql "SELECT robot, count(*) FROM runs GROUP BY robot"
    modelgap sql --schema
    modelgap sql --named error_by_trajectory --format csv
    modelgap sql --named runs_of_model --with model=3f2a
    modelgap sql "FROM samples WHERE run_id = '...'" --format parquet --out run.parquet
    ```

    The store is opened for reading only. Without an argument, one query is read from
    standard input. A query may use half of this machine's memory, its answer a quarter.
    Damaged samples are an error that names the run. JSON holds numbers that are not
    finite as the texts NaN, Infinity and -Infinity.

    Args:
        query: One SELECT over the views, in the SQL of DuckDB.
        named: Name of a ready query (--schema lists them).
        with_: Value of a ready query, as name=value; may be repeated.
        schema: Show the views with the unit of every column, and the ready queries.
        format: Format of the answer; parquet needs --out on a terminal.
        out: File for the answer, not among the records of the store.
        timeout: Longest time of the query, in seconds; inf for no limit.
        without_damaged: Leave damaged records out, and list them.
    """
    place = store_folder(store)
    if json is not None:
        if out or format != "table":
            raise InputError("--json sets format and file: omit --format and --out.")
        format, out = "json", json if json != STDOUT else None
    choices = [query is not None, named is not None, schema]
    if sum(choices) > 1 or (sys.stdin.isatty() and not any(choices)):
        raise InputError(_ONE_OF)
    if with_ and named is None:
        raise InputError("--with sets a value of a ready query: --named NAME.")
    check_shown(format, out)
    check_writable({"--out": Path(out)} if out else {}, ())
    check_outside("--out", out, place)
    if not timeout > 0:
        raise InputError(f"--timeout {timeout}: expected seconds above 0, or inf.")
    limit = timeout if timeout <= threading.TIMEOUT_MAX else None
    if schema:
        _write(schema_table(), format, out)
        if out is None and format == "table":
            print()
            print_table(named_table(), "table")
        return
    text, values = _query(query, named, with_)
    with open_store(place) as opened:
        rows = opened.sql(text, values, without_damaged=without_damaged, timeout=limit)
        _write(rows, format, out)
        tell_damage(opened)


def _query(
    query: str | None, named: str | None, pairs: Sequence[str]
) -> tuple[str, Mapping[str, str]]:
    """Return the SQL and the values of its parameters."""
    if named is None:
        query = query if query is not None else sys.stdin.read(LONGEST + 1)
        if not query.strip():
            raise InputError(_ONE_OF)
        return query, {}
    name = check_name(named, NAMED, "named query")
    values = {key: value for key, _, value in (pair.partition("=") for pair in pairs)}
    takes = values_of(name)
    if set(values) != set(takes) or len(values) < len(pairs) or "" in values.values():
        words = " ".join(f"--with {key}=... ({about})" for key, about in takes.items())
        raise InputError(
            f"'{name}' takes {words or 'no --with'}, got {', '.join(pairs) or 'none'}."
        )
    return NAMED[name][1], values


def _write(rows: pa.Table, format: str, out: str | None) -> None:
    if out is None:
        print_table(rows, format)
        return
    write_all({Path(out): as_bytes(rows, format)})
    print(f"wrote {out}: {len(rows)} {'row' if len(rows) == 1 else 'rows'}")
