"""The store from Python: SQL in, finished tables out."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from flows.settings import store_folder
from residual.errors import InputError
from warehouse.query.named import NAMED

if TYPE_CHECKING:
    from warehouse.query.store import Store as OpenedStore

_SHOWN, _WIDE = 40, 60  # rows and letters of a cell; more is for programs


class Table:
    """Rows of named columns. It is all in memory; nothing is asked again.

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
        """The table as PyArrow holds it."""
        return self._rows

    def rows(self) -> list[dict[str, Any]]:
        """One mapping per row."""
        return self._rows.to_pylist()

    def df(self) -> Any:
        """The table as a pandas DataFrame, where pandas is installed."""
        try:
            return self._rows.to_pandas()
        except ImportError as error:
            raise _not_installed("pandas", "df") from error

    def pl(self) -> Any:
        """The table as a Polars DataFrame, where Polars is installed."""
        try:
            import polars  # pyright: ignore[reportMissingImports]  optional
        except ImportError as error:
            raise _not_installed("polars", "pl") from error
        return polars.from_arrow(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[Mapping[str, Any]]:
        return iter(self.rows())

    def __getitem__(self, which: str | int) -> Any:
        if isinstance(which, str):
            return self._rows.column(which).to_pylist()
        return self._rows.take([range(len(self))[which]]).to_pylist()[0]

    def __repr__(self) -> str:
        rows = self._rows.slice(0, _SHOWN).to_pylist()
        lines = [self.columns, *(list(map(_text, row.values())) for row in rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        text = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in lines]
        more = len(self) - _SHOWN
        return "\n".join([*text, *([f"… and {more} more rows"] if more > 0 else [])])


def _text(value: object) -> str:
    if value is None:
        return "–"
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return text if len(text) <= _WIDE else f"{text[: _WIDE - 1]}…"


def _not_installed(library: str, method: str) -> InputError:
    return InputError(
        f".{method}() needs {library}, which is not installed. Install it, or use "
        ".arrow() or .rows()."
    )


class Store:
    """A store that is open for reading. It sees what others commit meanwhile.

    Attributes:
        path: Its folder.
    """

    def __init__(self, opened: "OpenedStore") -> None:
        self._opened = opened
        self.path = opened.path

    def sql(self, text: str, **values: object) -> Table:
        """Return the finished answer to one SELECT over the views of the store.

        Args:
            text: SQL of DuckDB, or the name of a query of ``named``.
            values: What stands for the $words in it.

        Raises:
            InputError: If it is anything else than one SELECT, or it fails.
        """
        text = NAMED[text][1] if text in NAMED else text
        return Table(self._opened.sql(text, values or None))

    @property
    def named(self) -> Mapping[str, str]:
        """Names of ready queries, and what each answers."""
        return {name: about for name, (about, _) in NAMED.items()}

    def close(self) -> None:
        """Let go of the store."""
        self._opened.close()

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        count = self._opened.sql("SELECT count(*) AS n FROM runs")
        return f"Store({self.path.name}: {count['n'][0]} runs)"


def open_store(path: str | Path | None = None) -> Store:
    """Open a store for reading.

    Args:
        path: Its folder; None for the usual one: $MODELGAP_STORE, else ./store.

    Raises:
        InputError: If there is none.
    """
    from warehouse.query import store

    return Store(store.open_store(store_folder(path and str(path))))
