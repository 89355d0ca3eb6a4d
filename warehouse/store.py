"""The store as a database: open it and ask in SQL."""

from contextlib import suppress
from pathlib import Path

import duckdb
import pyarrow as pa

from residual.errors import InputError
from warehouse.catalogue import read_catalogue
from warehouse.files import read_parquet
from warehouse.guard import check_reads_only, first_line
from warehouse.layout import INDEX, KINDS, SAMPLES_FILE
from warehouse.quarantine import quarantined
from warehouse.queries import catalogue_views, samples_view, text
from warehouse.schema import SIGNALS, TEXT

# Outside of these no query reads anything: not the sealed halves, not the machine.
READABLE = ("samples", "models", "diagnoses", "validations", INDEX)


def open_store(path: Path | str) -> "Store":
    """Open a store for reading.

    Args:
        path: Folder of the store.

    Raises:
        InputError: If there is none.
    """
    folder = Path(path).resolve()
    if not folder.is_dir():
        raise InputError(
            f"There is no store at {path}. Make one with modelgap experiment or demo, "
            "or say where it is: --store FOLDER."
        )
    if set(str(folder)) & set("*?[]{}"):
        raise InputError(f"{path}: the path of a store must not contain * ? [ ] {{ }}.")
    return Store(folder)


class Store:
    """An opened store; it sees what others commit meanwhile.

    Attributes:
        path: Its folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._connection = _hardened(path)
        self._left_out: dict[str, str] = {}
        self._quarantined = quarantined(path)
        self._catalogue = read_catalogue(path)
        self._table("signals", _signals())
        self._load_quarantined()
        self._load_catalogue()
        for name, query in catalogue_views().items():
            self._connection.execute(f"CREATE VIEW {name} AS {query}")

    @property
    def damaged(self) -> tuple[str, ...]:
        """One line for each file that cannot be read and is left out."""
        return (*self._catalogue.damaged, *self._left_out.values())

    def sql(self, query: str) -> pa.Table:
        """Return the answer to one SELECT, or EXPLAIN of one, over the views.

        Args:
            query: SQL of DuckDB; views and columns are those of ``schema``.

        Raises:
            InputError: If the query is refused or fails; one line says why.
        """
        reading = check_reads_only(self._connection, query)
        self.refresh()
        while True:
            try:
                return self._read(reading)
            except duckdb.Error as error:
                # Ask again without the files that cannot be read, if that was it.
                if not self._leave_out(error):
                    raise InputError(_explain(error)) from error
                self._make_samples()

    def refresh(self) -> None:
        """See what was committed or quarantined since."""
        marked = quarantined(self.path)
        if marked != self._quarantined:
            self._quarantined = marked
            self._load_quarantined()
        catalogue = read_catalogue(self.path, self._catalogue)
        if catalogue is not self._catalogue:
            self._catalogue = catalogue
            self._load_catalogue()

    def close(self) -> None:
        """Let go of the connection."""
        self._connection.close()

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read(self, query: str) -> pa.Table:
        # The second lock: what slips past the guard cannot write tables either.
        self._connection.execute("BEGIN TRANSACTION READ ONLY")
        try:
            return self._connection.sql(query).to_arrow_table()
        finally:
            with suppress(duckdb.Error):
                self._connection.execute("ROLLBACK")

    def _table(self, name: str, rows: pa.Table) -> None:
        self._connection.register("_rows", rows)
        self._connection.execute(
            f"CREATE OR REPLACE TABLE catalogue.{name} AS FROM _rows"
        )
        self._connection.unregister("_rows")

    def _load_quarantined(self) -> None:
        ids = pa.array(sorted(self._quarantined), TEXT)
        self._table("quarantine", pa.table({"run_id": ids}))

    def _load_catalogue(self) -> None:
        for kind, rows in self._catalogue.rows.items():
            self._table(kind, rows)
        self._make_samples()

    def _make_samples(self) -> None:
        while True:
            query = f"CREATE OR REPLACE VIEW samples AS {samples_view(self._groups())}"
            try:
                self._connection.execute(query)
                return
            except duckdb.Error as error:
                if not self._leave_out(error):
                    raise

    def _groups(self) -> dict[tuple[tuple[str, ...], int], list[str]]:
        """Return the files with samples by the signals and joints that they hold."""
        groups: dict = {}
        rows = self._catalogue.rows["runs"].select(["run_id", "signals", "dof"])
        for row in rows.to_pylist():
            folder = self._catalogue.folders["runs"][row["run_id"]]
            file = f"{folder}/{SAMPLES_FILE}"
            if file not in self._left_out:
                held = (tuple(row["signals"]), row["dof"])
                groups.setdefault(held, []).append(file)
        return groups

    def _leave_out(self, error: duckdb.Error) -> bool:
        """Leave out the damaged files that an error is about; whether there are any."""
        folders = self._catalogue.folders["runs"].values()
        files = {f"{folder}/{SAMPLES_FILE}" for folder in folders} - set(self._left_out)
        named = {file for file in files if file in str(error)}
        # A page that makes no sense is told without the name of its file.
        nameless = type(error) in (duckdb.Error, duckdb.IOException)
        before = len(self._left_out)
        for file in sorted(named or (files if nameless else ())):
            # Read, not believed: a query may have an error and a path in its text.
            try:
                read_parquet(Path(file))
            except InputError as told:
                self._left_out[file] = str(told)
        return len(self._left_out) > before


def _hardened(path: Path) -> duckdb.DuckDBPyConnection:
    """Return a connection that reaches nothing but what may be read of a store."""
    connection = duckdb.connect(":memory:")
    connection.execute("CREATE SCHEMA catalogue")
    allowed = ", ".join(text(f"{path}/{folder}") for folder in READABLE)
    for setting in (
        "autoinstall_known_extensions = false",
        "autoload_known_extensions = false",
        # A query must not see the variables of the program that asks it.
        "python_enable_replacements = false",
        "temp_directory = ''",
        f"allowed_directories = [{allowed}]",
        "enable_external_access = false",
        "lock_configuration = true",
    ):
        connection.execute(f"SET {setting}")
    return connection


def _signals() -> pa.Table:
    return pa.table(
        {
            "signal": list(SIGNALS),
            "unit": [signal.unit for signal in SIGNALS.values()],
            "per_joint": [signal.per_joint for signal in SIGNALS.values()],
        }
    )


def _explain(error: duckdb.Error) -> str:
    if isinstance(error, duckdb.PermissionException):
        what = first_line(error).removeprefix("Permission Error: ")
        return f"SQL reads {', '.join(KINDS)} of this store, nothing else. {what}"
    return first_line(error)
