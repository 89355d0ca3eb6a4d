"""modelgap runs, sql and show: what the store remembers."""

from typing import Annotated, Literal

from cyclopts import Parameter

Format = Literal["table", "csv", "json"]
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
    schema: Annotated[bool, Parameter(negative="")] = False,
    format: Format = "table",
    store: _Store = None,
) -> None:
    """Ask the store in SQL; it can only be read.

    ```
    modelgap sql "SELECT robot, count(*) FROM runs GROUP BY robot"
    modelgap sql --schema
    modelgap sql --named error_by_trajectory --format csv
    ```

    Args:
        query: One SELECT over the views, in the SQL of DuckDB.
        named: A query that comes with the program, by its name.
        schema: Show the views with every column and its unit, and the named queries.
        format: How to print the answer.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    from flows.cli.store_work import answer

    answer(store, query, named, schema, format)


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
