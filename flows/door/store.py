"""The store from Python: SQL in, finished tables out."""

from collections.abc import Mapping
from pathlib import Path

from flows.door.table import Table
from flows.settings import store_folder
from warehouse.query import store as query
from warehouse.query.named import NAMED

__all__ = ["Store", "open_store"]


class Store:
    """A store that is open for reading. It sees what others commit meanwhile.

    Attributes:
        path: Its folder.
    """

    def __init__(self, opened: query.Store) -> None:
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
    return Store(query.open_store(store_folder(path and str(path))))
