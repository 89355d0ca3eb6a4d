"""The store as a database: open it and ask in SQL."""

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import duckdb
import pyarrow as pa

from residual.errors import InputError
from warehouse.files import read_parquet
from warehouse.layout import INDEX, KINDS, SAMPLES_FILE
from warehouse.query.catalogue import read_catalogue
from warehouse.query.guard import check_reads_only, first_line
from warehouse.query.packs import Held, Pack, Packed, read_packs, write_packs
from warehouse.query.views import catalogue_views, samples_view, text
from warehouse.runs import quarantined
from warehouse.schema import SIGNALS, TEXT

# Outside of these no query reads anything: not the sealed halves, not the machine.
READABLE = ("samples", "models", "diagnoses", "validations", INDEX)

# A run of up to this size is read faster from a copy beside others [bytes].
SMALL = 1_000_000
# Share of the memory that one answer may take, and samples that are fetched at once.
LARGEST, _BATCH = 0.25, 100_000


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
        self._packs: tuple[Pack, ...] = ()
        self._table("signals", _signals())
        self._load_quarantined()
        self._load_catalogue()
        for name, query in catalogue_views().items():
            self._connection.execute(f"CREATE VIEW {name} AS {query}")

    @property
    def damaged(self) -> tuple[str, ...]:
        """One line for each file that cannot be read and is left out."""
        return (*self._catalogue.damaged, *self._left_out.values())

    def sql(self, query: str, values: Mapping[str, object] | None = None) -> pa.Table:
        """Return the answer to one SELECT, or EXPLAIN of one, over the views.

        Args:
            query: SQL of DuckDB; views and columns are those of ``schema``.
            values: What stands for the $words in it; never a part of the text.

        Raises:
            InputError: If the query is refused or fails; one line says why.
        """
        reading = check_reads_only(self._connection, query)
        self.refresh()
        while True:
            try:
                return self._read(reading, values)
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

    def compact(self, largest: int = SMALL) -> Packed:
        """Copy the samples of small runs into a few files, for queries over many.

        Args:
            largest: Size of the samples of a run that still counts as small [bytes].

        Returns:
            What was done.
        """
        self.refresh()
        done = write_packs(self.path, self._groups(), largest)
        self._load_catalogue()
        return done

    def close(self) -> None:
        """Let go of the connection."""
        self._connection.close()

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read(self, query: str, values: Mapping[str, object] | None) -> pa.Table:
        # The second lock: what slips past the guard cannot write tables either.
        self._connection.execute("BEGIN TRANSACTION READ ONLY")
        try:
            asked = self._connection.sql(query, params=dict(values) if values else None)
            return _collected(asked.to_arrow_reader(_BATCH))
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
        self._packs = read_packs(self.path, self._catalogue.folders["runs"])
        self._make_samples()

    def _make_samples(self) -> None:
        while True:
            packs = [(pack.held, pack.file) for pack in self._packs]
            packed = frozenset().union(*(pack.runs for pack in self._packs))
            view = samples_view(self._groups(packed), packs)
            query = f"CREATE OR REPLACE VIEW samples AS {view}"
            try:
                self._connection.execute(query)
                return
            except duckdb.Error as error:
                if not self._leave_out(error):
                    raise

    def _groups(self, without: frozenset[str] = frozenset()) -> dict[Held, list[str]]:
        """Return the files with samples by the signals and joints that they hold."""
        groups: dict = {}
        rows = self._catalogue.rows["runs"].select(["run_id", "signals", "dof"])
        for row in rows.to_pylist():
            if row["run_id"] in without:
                continue
            folder = self._catalogue.folders["runs"][row["run_id"]]
            file = f"{folder}/{SAMPLES_FILE}"
            if file not in self._left_out:
                held = (tuple(row["signals"]), row["dof"])
                groups.setdefault(held, []).append(file)
        return groups

    def _leave_out(self, error: duckdb.Error) -> bool:
        """Leave out the damaged files that an error is about; whether there are any."""
        copies = any(pack.file in str(error) for pack in self._packs)
        if self._packs and (copies or _is_of_files(error)):
            # Copies, so nothing is lost: the runs themselves are read instead.
            self._packs = ()
            return True
        folders = self._catalogue.folders["runs"].values()
        files = {f"{folder}/{SAMPLES_FILE}" for folder in folders} - set(self._left_out)
        named = {file for file in files if file in str(error)}
        # A page that makes no sense is told without the name of its file.
        nameless = _is_of_files(error)
        before = len(self._left_out)
        for file in sorted(named or (files if nameless else ())):
            # Read, not believed: a query may have an error and a path in its text.
            try:
                read_parquet(Path(file))
            except InputError as told:
                self._left_out[file] = str(told)
        return len(self._left_out) > before


def _collected(reader: pa.RecordBatchReader) -> pa.Table:
    """Return an answer as a whole if that can be held."""
    batches, size, most = [], 0, LARGEST * _memory()
    # Closed also where it is too large: what is not read would hold the transaction.
    with reader:
        for batch in reader:
            batches.append(batch)
            size += batch.nbytes
            if size > most:
                raise InputError(
                    f"The answer is larger than {most / 2**30:.2g} GB. Ask for less: "
                    "aggregate, or add LIMIT or a WHERE."
                )
    return pa.Table.from_batches(batches, reader.schema)


def _memory() -> int:
    """Memory of this machine [bytes]."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


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
        # What a query may take: the answer comes on top of it.
        f"memory_limit = '{int(0.5 * _memory())}B'",
        f"allowed_directories = [{allowed}]",
        "enable_external_access = false",
        "lock_configuration = true",
    ):
        connection.execute(f"SET {setting}")
    return connection


def _is_of_files(error: duckdb.Error) -> bool:
    """Whether an error may be about a file, though it need not name it."""
    return type(error) in (duckdb.Error, duckdb.IOException)


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
