"""The store from Python: SQL in, tables in memory out."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from flows.settings import resolve_store_folder
from residual.errors import InputError

if TYPE_CHECKING:
    from warehouse.queries import Store as StoreReader


class Table:
    """Rows of named columns, all in memory.

    Iterating gives a mapping per row; ``table["name"]`` is a column, ``table[0]`` a
    row.
    """

    def __init__(self, rows: pa.Table) -> None:
        self._rows = rows

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return self._rows.column_names

    def arrow(self) -> pa.Table:
        """The table as a PyArrow table."""
        return self._rows

    def rows(self) -> list[dict[str, Any]]:
        """One mapping per row."""
        return self._rows.to_pylist()

    def df(self) -> Any:
        """The table as a pandas DataFrame; InputError where pandas is missing."""
        return self._frame("df", "pandas")

    def pl(self) -> Any:
        """The table as a Polars DataFrame; InputError where Polars is missing."""
        return self._frame("pl", "Polars")

    def _frame(self, method: str, library: str) -> Any:
        import duckdb

        try:
            return getattr(duckdb.from_arrow(self._rows), method)()
        except (ImportError, duckdb.InvalidInputException) as error:
            raise InputError(
                f".{method}() needs {library}, which is not installed. Install it, or "
                "use .arrow() or .rows()."
            ) from error

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[Mapping[str, Any]]:
        return iter(self.rows())

    def __getitem__(self, key: str | int) -> Any:
        if isinstance(key, str):
            return self._rows.column(key).to_pylist()
        return self._rows.take([range(len(self))[key]]).to_pylist()[0]

    def __repr__(self) -> str:
        import duckdb

        return str(duckdb.from_arrow(self._rows))


class Store:
    """A store open for reading; it shows what other programs commit meanwhile.

    Attributes:
        path: Its folder.
    """

    def __init__(self, reader: "StoreReader") -> None:
        self._reader = reader
        self.path = reader.path

    def sql(self, text: str, *, truth: bool = False, **values: object) -> Table:
        """Return the answer to one SELECT over the views of the store.

        Args:
            text: SQL of DuckDB, or the name of a query of ``named``.
            truth: Open the seals of all simulated runs, and mark these as opened: this
                query has the view ``truth``.
            values: Values of the $parameters in it.

        Raises:
            InputError: If it is not one SELECT, or it fails; with `truth` also if the
                store cannot be written.
        """
        if truth:
            from flows.sealed_truth import show_truth
            from warehouse.queries import open_store

            with open_store(self.path) as reader:  # a connection of its own
                show_truth(reader)
                return Table(reader.sql(text, values or None))
        from warehouse.sql_guard import NAMED

        text = NAMED[text][1] if text in NAMED else text
        return Table(self._reader.sql(text, values or None))

    @property
    def named(self) -> Mapping[str, str]:
        """Named queries, each with one sentence."""
        from warehouse.sql_guard import NAMED

        return {name: about for name, (about, _) in NAMED.items()}

    def close(self) -> None:
        """Close the store."""
        self._reader.close()

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        count = self._reader.sql("SELECT count(*) AS n FROM runs")
        return f"Store({self.path.name}: {count['n'][0]} runs)"


def open_store(path: str | Path | None = None) -> Store:
    """Open a store for reading.

    Args:
        path: Its folder; None for $MODELGAP_STORE, else ./store.

    Raises:
        InputError: If there is none.
    """
    from warehouse import queries

    return Store(queries.open_store(resolve_store_folder(path and str(path))))
