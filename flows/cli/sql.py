"""modelgap sql: ask the store."""

import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import pyarrow as pa
from cyclopts import Parameter

from flows import requests
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
from flows.settings import store_folder
from residual.errors import InputError, check_name
from warehouse.query.guard import LONGEST
from warehouse.query.named import NAMED
from warehouse.query.store import Store, open_store

with suppress(ImportError):
    import readline  # noqa: F401  gives the prompt its arrow keys

FIRST, NEXT = "modelgap> ", "     ...> "
HELP = (
    "A query ends with ; or an empty line. Ctrl-D ends. Views: modelgap sql --schema."
)
LIST = "list"  # what a lone --named asks for
_ONE_OF = 'Give one of: a query in quotes ("SELECT ..."), --named NAME, --schema.'


@dataclass(frozen=True, slots=True)
class Sql(requests.Request):
    """What is asked of the store, and where the answer goes.

    Attributes:
        query: One SELECT over the views, in the SQL of DuckDB.
        named: A query that comes with the program, by its name; without one they are
            listed.
        with_: A value for a named query, as name=value.
        schema: Show the views with every column and its unit, and the named queries.
        format: How to print the answer; parquet needs --out on a terminal.
        out: File for the answer, not among the records of the store.
        timeout: Seconds that a query may take; inf for no end.
        without_damaged: Answer from what is whole, and say what was left out.
    """

    query: Annotated[str | None, Parameter(parse=False)] = None
    named: requests.Name = None
    with_: Annotated[requests.Tags, Parameter(name="--with", metavar="KEY=VALUE")] = ()
    schema: requests.Flag = False
    format: requests.Format = "table"
    out: requests.File = None
    timeout: requests.Seconds = 60.0
    without_damaged: requests.Flag = False
    store: requests.Store = None


_NOTHING = Sql()


def sql(
    query: str | None = None, /, *, request: Sql = _NOTHING, json: requests.Json = None
) -> None:
    """Ask the store in SQL; it can only be read.

    ```
    modelgap sql "SELECT robot, count(*) FROM runs GROUP BY robot"
    modelgap sql --schema
    modelgap sql --named
    modelgap sql --named error_by_trajectory --format csv
    modelgap sql --named runs_of_model --with model=3f2a
    modelgap sql "FROM samples WHERE run_id = '...'" --format parquet --out run.parquet
    ```

    Without a query on a terminal: one query after the other, each ended by ;.
    Without a terminal one query is read from standard input.

    A query may take half of this machine's memory, its answer a quarter. What it reads
    is checked: damaged samples are an error that names the run. JSON has numbers that
    are not finite as the texts NaN, Infinity and -Infinity, since it knows no such
    numbers.

    Args:
        query: One SELECT over the views, in the SQL of DuckDB.
    """
    request = replace(request, query=query, store=store_folder(request.store))
    if json is not None:
        if request.out or request.format != "table":
            raise InputError("--json says form and file: give no --format or --out.")
        request = replace(request, format="json", out=json if json != STDOUT else None)
    chosen = [query is not None, request.named is not None, request.schema]
    if sum(chosen) > 1:
        raise InputError(_ONE_OF)
    if request.with_ and request.named in (None, LIST):
        raise InputError("--with gives a value to a query of --named NAME.")
    format, out = request.format, request.out
    check_shown(format, out)
    check_writable({"--out": Path(out)} if out else {}, ())
    check_outside("--out", out, request.store)
    limit = _limit(request.timeout)
    how = {"without_damaged": request.without_damaged, "timeout": limit}
    if request.schema:
        _give(schema_table(), format, out)
        if out is None and format == "table":
            print()
            print_table(named_table(), "table")
    elif request.named == LIST:
        _give(named_table(), format, out)
    elif not any(chosen) and sys.stdin.isatty():
        with open_store(request.store) as opened:
            prompt(opened, format, **how)
    else:
        text, values = _query_of(request)
        with open_store(request.store) as opened:
            _give(opened.sql(text, values, **how), format, out)
            tell_damage(opened)


def _limit(timeout: float) -> float | None:
    """Return how long a query may take [s]; None for ever."""
    if not timeout > 0:
        raise InputError(f"--timeout {timeout}: expected seconds above 0, or inf.")
    return timeout if timeout <= threading.TIMEOUT_MAX else None


def prompt(store: Store, format: str, **how: object) -> None:
    """Read queries and print answers until the end; an error ends only its query.

    Args:
        store: The opened store.
        format: How to print answers.
        how: Options of every query (`Store.sql`).
    """
    print(HELP)
    for query in _typed():
        try:
            print_table(store.sql(query, **how), format)
            tell_damage(store)
        except InputError as error:
            print(error)
        except KeyboardInterrupt:
            print("cancelled")


def _typed() -> Iterator[str]:
    lines: list[str] = []
    while True:
        try:
            line = input(NEXT if lines else FIRST).strip()
        except KeyboardInterrupt:
            print()
            lines.clear()
            continue
        except EOFError:
            print()
            return
        lines.append(line)
        if not line or line.endswith(";"):
            query = "\n".join(lines).strip()
            lines.clear()
            if query:
                yield query


def _query_of(request: Sql) -> tuple[str, Mapping[str, str]]:
    """Return the SQL, and the values of what stands for something in it."""
    if request.named is None:
        query = request.query
        query = query if query is not None else sys.stdin.read(LONGEST + 1)
        if not query.strip():
            raise InputError(_ONE_OF)
        return query, {}
    name = check_name(request.named, NAMED, "named query")
    return NAMED[name][1], _values(name, request.with_)


def _values(name: str, given: Sequence[str]) -> dict[str, str]:
    pairs = [word.partition("=") for word in given]
    values = {key: value for key, _, value in pairs}
    takes = values_of(name)
    if set(values) != set(takes) or len(values) < len(given) or "" in values.values():
        words = " ".join(f"--with {key}=... ({about})" for key, about in takes.items())
        raise InputError(
            f"'{name}' takes {words or 'no --with'}, got {', '.join(given) or 'none'}."
        )
    return values


def _give(rows: pa.Table, format: str, out: str | None) -> None:
    if out is None:
        print_table(rows, format)
        return
    write_all({Path(out): as_bytes(rows, format)})
    noun = "row" if len(rows) == 1 else "rows"
    print(f"wrote {out}: {len(rows)} {noun}")
