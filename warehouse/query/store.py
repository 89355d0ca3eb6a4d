"""The store as a database: open it and ask in SQL."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import duckdb
import pyarrow as pa

from residual.errors import InputError
from warehouse.files import read_parquet
from warehouse.layout import KINDS, SAMPLES_FILE
from warehouse.query.catalogue import read_catalogue
from warehouse.query.connection import (
    collected,
    explain,
    is_of_files,
    limited,
    lock,
    reads_only,
)
from warehouse.query.guard import check_reads_only, table_names
from warehouse.query.packs import Held, Pack, Packed, read_packs, write_packs
from warehouse.query.views import catalogue_views, samples_view
from warehouse.query.watched import Watched
from warehouse.runs import quarantined
from warehouse.schema import SIGNALS, TEXT, VIEWS

# A run of up to this size is read faster from a copy beside others [bytes].
SMALL = 1_000_000
_BATCH = 100_000  # samples that are fetched at once


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
        self._connection = reads_only(path)
        self._watched = Watched(self._connection)
        lock(self._connection)
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
        listed = self._catalogue.damaged.values()
        return (*(line for lines in listed for line in lines), *self._left_out.values())

    def sql(
        self,
        query: str,
        values: Mapping[str, object] | None = None,
        *,
        without_damaged: bool = False,
        timeout: float | None = None,
    ) -> pa.Table:
        """Return the answer to one SELECT, or EXPLAIN of one, over the views.

        Args:
            query: SQL of DuckDB; views and columns are those of ``schema``.
            values: What stands for the $words in it; never a part of the text.
            without_damaged: Answer from what is whole; what was left out is in
                ``damaged``.
            timeout: How long it may take [s]; None for ever.

        Raises:
            InputError: If the query is refused or fails, takes too long, or needs what
                is damaged; it says why.
        """
        reading = check_reads_only(self._connection, query)
        self.refresh()
        if not without_damaged:
            self._need_whole(reading)
        with limited(self._connection, timeout):
            while True:
                answer = self._tried(reading, values)
                if answer is not None:
                    return answer
                self._make_samples()
                if self._left_out and not without_damaged:
                    raise InputError(_needs_damaged(self._left_out.values()))

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

    def _tried(self, query: str, values: Mapping | None) -> pa.Table | None:
        """Return an answer; None where something it needs was damaged, now left out."""
        self._watched.forget()
        try:
            answer = self._read(query, values)
        except duckdb.InterruptException:
            raise
        except duckdb.Error as error:
            # Ask again without the files that cannot be read, if that was it.
            if self._drop(self._watched.broken()) or self._leave_out(error):
                return None
            raise InputError(explain(error)) from error
        return None if self._drop(self._watched.broken()) else answer

    def _read(self, query: str, values: Mapping | None) -> pa.Table:
        # The second lock: what slips past the guard cannot write tables either.
        self._connection.execute("BEGIN TRANSACTION READ ONLY")
        try:
            asked = self._connection.sql(query, params=dict(values) if values else None)
            return collected(asked.to_arrow_reader(_BATCH))
        finally:
            with suppress(duckdb.Error):
                self._connection.execute("ROLLBACK")

    def _need_whole(self, query: str) -> None:
        """Refuse a query over a view from which something damaged is missing."""
        if not self.damaged:
            return
        names = table_names(self._connection, query)
        kinds = {kind for name in names for kind in _FED_BY.get(name, ())}
        told = [line for k in sorted(kinds) for line in self._catalogue.damaged[k]]
        told += self._left_out.values() if "samples" in names else ()
        if told:
            raise InputError(_needs_damaged(told))

    def _drop(self, broken: Mapping[str, str]) -> bool:
        """Read no more of some files; whether there are any."""
        copies = {pack.file for pack in self._packs}
        if copies & broken.keys():
            # Copies, so nothing is lost: the runs themselves are read instead.
            self._packs = ()
        self._left_out |= {f: why for f, why in broken.items() if f not in copies}
        return bool(broken)

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
        self._watched.copies = {pack.file: pack.sums for pack in self._packs}
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
        if self._packs and (copies or is_of_files(error)):
            # Copies, so nothing is lost: the runs themselves are read instead.
            self._packs = ()
            return True
        folders = self._catalogue.folders["runs"].values()
        files = {f"{folder}/{SAMPLES_FILE}" for folder in folders} - set(self._left_out)
        named = {file for file in files if file in str(error)}
        # A page that makes no sense is told without the name of its file.
        nameless = is_of_files(error)
        before = len(self._left_out)
        for file in sorted(named or (files if nameless else ())):
            # Read, not believed: a query may have an error and a path in its text.
            try:
                read_parquet(Path(file))
            except InputError as told:
                self._left_out[file] = str(told)
        return len(self._left_out) > before


def _signals() -> pa.Table:
    return pa.table(
        {
            "signal": list(SIGNALS),
            "unit": [signal.unit for signal in SIGNALS.values()],
            "per_joint": [signal.per_joint for signal in SIGNALS.values()],
        }
    )


def _feeding(view: str) -> tuple[str, ...]:
    """Return the kinds of record that a view is made of."""
    if view in ("samples", "channels"):
        return ("runs",)
    if view == "adopted":
        return ("adoptions",)
    return tuple(k.name for k in KINDS.values() if view in (k.name, *k.lists))


_FED_BY = {view: _feeding(view) for view in (*VIEWS, "samples", "channels")}


def _needs_damaged(lines: Iterable[str]) -> str:
    told = list(lines)
    more = f" And {len(told) - 3} more." if len(told) > 3 else ""
    return (
        f"The answer needs what is damaged. {' '.join(told[:3])}{more} Or ask without "
        "it: --without-damaged."
    )
