"""modelgap runs, sql and show: what the store remembers."""

from typing import Annotated, Literal

from cyclopts import Parameter

Format = Literal["table", "csv", "json", "parquet"]
_Values = Annotated[tuple[str, ...], Parameter(name="--with", negative="")]
_Store = Annotated[str | None, Parameter(name="--store")]


def runs(
    limit: int = 50,
    format: Format = "table",
    store: _Store = None,
) -> None:
    """List the runs of the store, the latest last.

    ```
    modelgap runs
    modelgap runs --limit 1000 --format csv
    ```

    Args:
        limit: How many of the latest to list.
        format: How to print them.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    from flows.cli.store_work import list_runs

    list_runs(store, limit, format)


def sql(
    query: str | None = None,
    /,
    *,
    named: str | None = None,
    with_: _Values = (),
    schema: Annotated[bool, Parameter(negative="")] = False,
    format: Format = "table",
    out: str | None = None,
    store: _Store = None,
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

    Args:
        query: One SELECT over the views, in the SQL of DuckDB.
        named: A query that comes with the program, by its name; without one they are
            listed.
        with_: A value for a named query, as name=value.
        schema: Show the views with every column and its unit, and the named queries.
        format: How to print the answer; parquet needs --out on a terminal.
        out: File for the answer.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    from flows.cli.store_ask import Question, answer

    answer(Question(query, named, with_, schema, format, out), store)


def compact(*, largest: float = 1.0, store: _Store = None) -> None:
    """Copy the samples of many small runs into a few files, for SQL.

    ```
    modelgap compact
    ```

    Queries over thousands of small runs spend their time on opening files; after this
    they take a hundredth of it. The runs stay where they are; the copies lie in _index
    and can be deleted. Runs committed later are read as before, until the next compact.

    Args:
        largest: Runs with up to so many megabytes of samples are copied.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    from flows.cli.store_work import compact_runs

    compact_runs(store, largest)


def show(
    id: str,
    /,
    *,
    format: Literal["text", "json"] = "text",
    store: _Store = None,
) -> None:
    """Show all that is known of one run, model, diagnosis, validation or report.

    ```
    modelgap show 3f2a
    ```

    Args:
        id: Its id; the beginning is enough.
        format: How to print it.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    from flows.cli.store_work import show_record

    show_record(store, id, format)
