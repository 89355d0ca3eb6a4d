"""Which SQL may run: one SELECT that only reads, or an EXPLAIN of one.

The type of a statement is not enough. In DuckDB 2.0 all of these are SELECT or EXPLAIN
and write a file wherever files may be read:

    WITH x AS (COPY ... TO 'file') FROM x
    EXPLAIN ANALYZE COPY ... TO 'file'
    FROM json_execute_serialized_sql('{... the first one, serialised ...}')

DuckDB's settings come first: no external access but to `READABLE`, no extension, locked
configuration, read-only transaction. None of them stops a COPY into an allowed folder.
Therefore the parsed tree is searched, and every kind of query and every table function
in it must be on a list.
"""

import json
import os
import threading
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import duckdb
import pyarrow as pa

from residual.errors import InputError
from warehouse.view_schema import COMPUTED, INDEX, KINDS, SIGNALS, VIEWS, RecordKind, ViewColumn

_QUERIES = {"SELECT_NODE", "SET_OPERATION_NODE", "RECURSIVE_CTE_NODE", "CTE_NODE", "VALUES_NODE"}
_FUNCTIONS = {
    *("duckdb_columns", "duckdb_functions", "duckdb_tables", "duckdb_views"),
    *("generate_series", "histogram", "histogram_values", "json_each", "json_tree"),
    *("parquet_file_metadata", "parquet_kv_metadata", "parquet_metadata", "parquet_scan"),
    *("parquet_schema", "pragma_table_info", "range", "read_parquet", "repeat"),
    *("summary", "unnest"),
}
LONGEST = 100_000  # characters of a query
_LINE = 600  # characters of an error message
_DEEP = "The query is nested too deep. Ask with fewer subqueries and brackets."
_SCHEMA = "modelgap sql --schema"
_WRONG_QUERY = (duckdb.ParserException, duckdb.CatalogException, duckdb.BinderException)
_ONLY = "Only one SELECT, or EXPLAIN of one, runs here"

# Folders that a query may read: not the sealed halves, nothing else on the machine.
READABLE = ("samples", "models", "diagnoses", "validations", INDEX)
# Shares of the memory for a query, and for its answer on top of that.
WORKING, LARGEST = 0.5, 0.25


def check_reads_only(db: duckdb.DuckDBPyConnection, query: str) -> frozenset[str]:
    """Return the tables and views of a query, if it can only read."""
    if len(query) > LONGEST:
        raise InputError(f"The query has {len(query)} characters, at most {LONGEST} are allowed.")
    kind, text = _one_statement(db, query)
    select = _explained(text) if kind == "EXPLAIN" else text
    if kind not in ("SELECT", "EXPLAIN"):
        hint = " (a PIVOT needs its values: ON x IN (...))" if kind == "MULTI" else ""
        raise InputError(f"{_ONLY}, got {kind}{hint}. SQL can only read the store.")
    if kind == "EXPLAIN" and _one_statement(db, select)[0] != "SELECT":
        raise InputError(f"{_ONLY}, got EXPLAIN of something else.")
    return _tables(db, select)


def _one_statement(db: duckdb.DuckDBPyConnection, query: str) -> tuple[str, str]:
    try:
        statements = db.extract_statements(query)
        # A newer kind of statement is not in the library's list of types.
        kinds = [statement.type.name for statement in statements]
    except duckdb.Error as error:
        raise InputError(explain_error(error)) from error
    # A type error is due to text that is not UTF-8.
    except (TypeError, ValueError) as error:
        raise InputError(f"{_ONLY}, got something else.") from error
    if len(statements) != 1:
        raise InputError(f"{_ONLY}, got {len(statements) or 'no'} statements.")
    return kinds[0], statements[0].query


def _explained(text: str) -> str:
    """Return what follows EXPLAIN, its ANALYZE and its options."""
    data = text.encode()
    tokens = [(at, kind.name) for at, kind in duckdb.tokenize(text)]
    starts = [at for at, kind in tokens if kind != "comment"]
    words = [data[a:b].split()[0] for a, b in pairwise([*starts, None])]
    skip = 1
    if words[skip : skip + 1] == [b"("]:
        skip = words.index(b")") + 1
    elif words[skip : skip + 1] and words[skip].lower() in (b"analyze", b"analyse"):
        skip += 1
    return data[starts[skip] :].decode() if skip < len(starts) else ""


def _tables(connection: duckdb.DuckDBPyConnection, text: str) -> frozenset[str]:
    """Return tables and views of a SELECT in which nothing can write."""
    named = set()
    # fetchall: DuckDB 2.0 accepts no query before a result is read to its end.
    result = connection.execute("SELECT json_serialize_sql(?)", [text])
    try:
        tree = json.loads(result.fetchall()[0][0])
    except RecursionError as error:
        raise InputError(_DEEP) from error
    if tree.get("error"):
        raise InputError(f"{_ONLY}, got something that is neither.")
    parts = [tree["statements"]]
    while parts:
        node = parts.pop()
        if not isinstance(node, dict):
            parts += node if isinstance(node, list) else ()
            continue
        parts += node.values()
        kind = str(node.get("type", ""))
        if kind == "BASE_TABLE":
            named.add(str(node.get("table_name")).lower())
        if kind.endswith("_NODE") and kind not in _QUERIES:
            statement = kind.removesuffix("_NODE").removesuffix("_QUERY")
            raise InputError(f"{_ONLY}, got one that contains {statement}.")
        if kind == "TABLE_FUNCTION":
            name = str(node.get("function", {}).get("function_name", "")).lower()
            if name not in _FUNCTIONS:
                raise InputError(
                    f"SQL reads the views of the store, not '{name}()'. See {_SCHEMA}."
                )
    return frozenset(named)


def format_duckdb_error(error: Exception) -> str:
    """Return an error of DuckDB in one line, without its excerpt of the query."""
    text = str(error).split("\n\nLINE ")[0]
    line = " ".join(text.split()).removesuffix(".")
    line = line if len(line) <= _LINE else f"{line[: _LINE - 3]}..."
    return line if line.endswith("?") else f"{line}."


def open_read_only_connection(path: Path) -> duckdb.DuckDBPyConnection:
    """Return a connection that can only read the open part of a store."""
    connection = duckdb.connect(":memory:")
    connection.execute("CREATE SCHEMA catalogue")
    connection.execute("CALL enable_logging('FileSystem')")
    folders = (f"{path}/{folder}".replace("'", "''") for folder in READABLE)
    allowed = ", ".join(f"'{folder}'" for folder in folders)
    for setting in (
        "autoinstall_known_extensions = false",
        "autoload_known_extensions = false",
        # A query must not see the variables of the calling program.
        "python_enable_replacements = false",
        # A cached file would not be checked again after damage.
        "enable_external_file_cache = false",
        "temp_directory = ''",
        f"memory_limit = '{int(WORKING * read_machine_memory())}B'",
        f"allowed_directories = [{allowed}]",
        "enable_external_access = false",
        "lock_configuration = true",
    ):
        connection.execute(f"SET {setting}")
    return connection


def read_machine_memory() -> int:
    """Return the memory of this machine [bytes]."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


@contextmanager
def limit_process_memory() -> Iterator[None]:
    """Limit the memory of this program to that of a query and its answer, on Linux.

    DuckDB limits its tables, but not the lists of an expression: `unnest(range(1e9))`
    takes all of the memory, and the system kills programs.
    """
    used = Path("/proc/self/statm")
    if not used.exists():
        yield
        return
    import resource

    before = resource.getrlimit(resource.RLIMIT_AS)
    most = int(used.read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    most += int((WORKING + LARGEST) * read_machine_memory())
    set_limits = [limit for limit in before if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([most, *set_limits]), before[1]))
    try:
        yield
    except MemoryError as error:
        raise InputError(
            "Query and answer need more than three quarters of this machine's memory. Ask "
            "for less: aggregate, or add LIMIT or a WHERE; --format csv or parquet takes less."
        ) from error
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def collect_answer(reader: pa.RecordBatchReader) -> pa.Table:
    """Return the full answer if it fits into its share of the memory."""
    batches, size, most = [], 0, LARGEST * read_machine_memory()
    # Closed also if it is too large: an unread rest would hold the transaction.
    with reader:
        for batch in reader:
            batches.append(batch)
            size += batch.nbytes
            if size > most:
                raise InputError(
                    f"The answer is larger than {most / 2**30:.2g} GB, a quarter of "
                    "this machine's memory. Ask for less: aggregate, or add LIMIT or a WHERE."
                )
    return pa.Table.from_batches(batches, reader.schema)


@contextmanager
def limit_query_time(
    connection: duckdb.DuckDBPyConnection, seconds: float | None
) -> Iterator[None]:
    """Interrupt a query after some seconds; None for no limit."""
    if seconds is None:
        yield
        return
    late = threading.Event()

    def stop() -> None:
        late.set()
        connection.interrupt()

    timer = threading.Timer(seconds, stop)
    timer.daemon = True
    timer.start()
    try:
        yield
    except (duckdb.Error, InputError) as error:
        if late.is_set():
            raise InputError(
                f"The query was stopped after {seconds:g} s. Ask for less, or give it "
                "more time with --timeout SECONDS."
            ) from error
        raise
    finally:
        timer.cancel()
        # A thread that outlives the program keeps the connection, a leak to nanobind.
        timer.join()


def explain_error(error: Exception) -> str:
    """Return what an error means for the user, in one line."""
    if isinstance(error, duckdb.PermissionException):
        reason = format_duckdb_error(error).removeprefix("Permission Error: ")
        return f"SQL reads {', '.join(KINDS)} of this store, nothing else. {reason}"
    if isinstance(error, duckdb.OutOfMemoryException):
        most = WORKING * read_machine_memory() / 2**30
        return (
            f"The query needs more than {most:.2g} GB, half of this machine's memory. "
            f"Ask for less: aggregate, or add a WHERE. "
            f"({format_duckdb_error(error)[:100]})"
        )
    # An error of Python, which DuckDB returns with its traceback.
    text = str(error).rstrip().splitlines()[-1] if "Traceback" in str(error) else ""
    query_is_wrong = isinstance(error, _WRONG_QUERY)
    hint = f" {_SCHEMA} names the views and columns." if query_is_wrong else ""
    return text or format_duckdb_error(error) + hint


_SQL = tomllib.loads(Path(__file__).with_name("catalogue.toml").read_text(encoding="utf-8"))


def build_catalogue_views() -> dict[str, str]:
    """Return the query behind each view that is made of catalogue rows, by name.

    Views with special queries are in catalogue.toml beside this file.
    """
    parts = " UNION ALL ".join(
        f"SELECT {KINDS[name].key} AS id, unnest(lineage, recursive := true) FROM catalogue.{name}"
        for name in COMPUTED
        if name in KINDS
    )
    views = {"catalogue.arms": _SQL["arms"].format(parts=parts)}
    views |= {name: _rows(kind) for name, kind in KINDS.items() if name != "runs"}
    views["runs"] = _SQL["runs"].format(columns=_listed(VIEWS["runs"][:-2]))
    views["channels"] = _SQL["channels"]
    views["adopted"] = _SQL["adopted"].format(columns=_listed(VIEWS["adopted"]))
    views["verdicts"] = _SQL["verdicts"]
    for view in dict.fromkeys(v for kind in KINDS.values() for v in kind.nested_views):
        kinds = [kind for kind in KINDS.values() if view in kind.nested_views]
        queries = [_unnested(view, kind.name, kind.key) for kind in kinds]
        views[view] = " UNION ALL ".join(queries)
    views["errors"] = _SQL["errors"].format(errors=views["errors"])
    return views


def _rows(kind: RecordKind) -> str:
    """Return the query of a kind of record, with its arm and time."""
    columns = _listed(VIEWS[kind.name])
    computed = COMPUTED.get(kind.name, ())
    if not computed:
        return f"SELECT {columns} FROM catalogue.{kind.name}"
    more = ", ".join(f"arm.{column.name}" for column in computed)
    shown = "own.*"
    if any(column.name == "serial" for column in VIEWS[kind.name]):
        shown += " REPLACE (coalesce(own.serial, arm.serial) AS serial)"
    return (
        f"SELECT {shown}, {more} FROM (SELECT {columns} FROM catalogue.{kind.name}) own "
        f"LEFT JOIN catalogue.arms arm ON arm.id = own.{kind.key}"
    )


def _listed(columns: Iterable[ViewColumn]) -> str:
    return ", ".join(f'"{column.name}"' for column in columns)


def _unnested(view: str, kind: str, key: str) -> str:
    key_column, *columns_of_row = VIEWS[view]
    columns = ", ".join(f'item."{c.name}" AS "{c.name}"' for c in columns_of_row)
    query = (
        f"SELECT {key} AS {key_column.name}, {columns} "
        f"FROM (SELECT {key}, unnest({view}) AS item FROM catalogue.{kind})"
    )
    if (view, kind) == ("errors", "diagnoses"):
        # With one held-out run a diagnosis has figures of that run and of all runs.
        return f"SELECT * EXCLUDE (value), min(value) AS value FROM ({query}) GROUP BY ALL"
    return query


def build_signal_table() -> pa.Table:
    """Return the rows of the view ``channels``, one per signal."""
    return pa.table(
        {
            "signal": list(SIGNALS),
            "unit": [signal.unit for signal in SIGNALS.values()],
            "per_joint": [signal.per_joint for signal in SIGNALS.values()],
        }
    )


_NAMED = tomllib.loads(Path(__file__).with_name("named.toml").read_text(encoding="utf-8"))
# Named queries of frequent questions: the question, the SQL, and the values that each
# needs.
NAMED = {name: (each["about"], each["sql"]) for name, each in _NAMED.items()}
TAKES = {name: each.get("takes", {}) for name, each in _NAMED.items()}
