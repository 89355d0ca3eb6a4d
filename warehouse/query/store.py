"""The store as a database: open it and ask in SQL."""

import json
import os
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import duckdb
import pyarrow as pa

from residual.errors import InputError
from warehouse.bucket import is_address
from warehouse.catalogue import read_catalogue
from warehouse.files import BLOCK, check_file, read_parquet
from warehouse.mirror import bucket_of, damaged, mirror_of, shown
from warehouse.query.guard import (
    check_reads_only,
    collected,
    explain,
    is_of_files,
    limited,
    lock,
    reads_only,
)
from warehouse.query.views import Held, catalogue_views, samples_view, signal_rows
from warehouse.runs import quarantined
from warehouse.schema import COMPUTED, KINDS, SAMPLES_FILE, TEXT, VIEWS

_READS = """
    SELECT message FROM duckdb_logs
    WHERE type = 'FileSystem' AND contains(message, '"op":"READ"')
"""
# One core hashes about as fast as two decode; more would take them from other work.
_THREADS = 2

_BATCH = 100_000  # samples that are fetched at once


# Which parts of which files a query has read, and whether they were whole.
#
# DuckDB logs each read with its place. Only these parts are checked, after the query
# and before anybody sees its answer: a query over one run of thousands checks that run,
# one over a single channel checks that channel. What was whole is not checked again
# while the file has the same size, time and inode.


class Watched:
    """The reads of one connection."""

    def __init__(self, connection: duckdb.DuckDBPyConnection) -> None:
        self._connection = connection
        self._whole: dict[tuple, set[int]] = defaultdict(set)
        # Before the settings are locked.
        connection.execute("CALL enable_logging('FileSystem')")

    def forget(self) -> None:
        """Begin anew: what was read so far is of no answer."""
        self._connection.execute("CALL truncate_duckdb_logs()")

    def broken(self) -> dict[str, str]:
        """Return what was read and is damaged: a message by the path of the file."""
        rows = self._connection.execute(_READS).fetchall()
        read: dict[str, set[int]] = defaultdict(set)
        for (message,) in rows:
            told = json.loads(message)
            first, size = int(told["pos"]), int(told["bytes"])
            read[told["path"]].update(
                range(first // BLOCK, (first + size - 1) // BLOCK + 1)
            )
        with ThreadPoolExecutor(_THREADS) as beside:
            checked = beside.map(self._check, read, read.values())
            told = zip(read, checked, strict=True)
            return {file: why for file, why in told if why}

    def _check(self, file: str, blocks: set[int]) -> str | None:
        """Return why a file is damaged; None where what was read of it is whole."""
        try:
            about = os.stat(file)
        except OSError as error:
            return str(damaged(Path(file), error.strerror))
        key = (file, about.st_ino, about.st_size, about.st_mtime_ns)
        new = blocks - self._whole[key]
        if not new:
            return None
        try:
            check_file(Path(file), new)
        except InputError as error:
            return str(error)
        self._whole[key] |= new
        return None


def _feeding(view: str) -> tuple[str, ...]:
    """Return the kinds of record that a view is made of."""
    if view in ("samples", "channels"):
        return ("runs",)
    if view == "verdicts":
        return ("diagnoses", "runs")
    if view == "adopted":
        return ("adoptions",)
    kinds = [k.name for k in KINDS.values() if view in (k.name, *k.lists)]
    # Serial number and time of recording are those of runs.
    return tuple(dict.fromkeys([*kinds, *(["runs"] if view in COMPUTED else [])]))


# Kinds of record that each view is made of.
FED_BY = {view: _feeding(view) for view in (*VIEWS, "samples", "channels")}


def needs_damaged(lines: Iterable[str]) -> str:
    """Return what to say of an answer that would need what is damaged."""
    told = list(lines)
    more = f" And {len(told) - 3} more." if len(told) > 3 else ""
    return (
        f"The answer needs what is damaged. {' '.join(told[:3])}{more} Or ask without "
        "it: --without-damaged."
    )


def open_store(path: Path | str) -> "Store":
    """Open a store for reading."""
    word = str(path)
    folder = mirror_of(word) if is_address(word) else Path(path).resolve()
    if not folder.is_dir():
        raise InputError(
            f"There is no store at {shown(folder)}. Make one with modelgap experiment "
            "or demo, or say where it is: --store FOLDER."
        )
    if set(str(folder)) & set("*?[]{}"):
        raise InputError(f"{path}: the path of a store must not contain * ? [ ] {{ }}.")
    return Store(folder)


def ask(path: Path, query: str, **values: object) -> list[dict]:
    """Return the rows of one answer; the store is open for it alone."""
    with open_store(path) as opened:
        return opened.sql(query, values or None).to_pylist()


class Store:
    """An opened store; it sees what others commit meanwhile."""

    def __init__(self, path: Path) -> None:
        self.path = path
        # Where the samples are if they are in a bucket: it checks them itself.
        self._remote = None
        if bucket_of(path) is not None:
            # Late: its library is a slow import, and of no use to a store in a folder.
            from warehouse.query.bucket_samples import BucketSamples

            self._remote = BucketSamples(path)
        self._connection = reads_only(path, self._remote)
        self._watched = self._remote or Watched(self._connection)
        lock(self._connection)
        self._left_out: dict[str, str] = {}
        self._quarantined = quarantined(path)
        self._catalogue = read_catalogue(path)
        self._table("signals", signal_rows())
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
        if self._remote and not self._shown:
            self._make_samples("samples" in reading.tables)
        if not without_damaged:
            self._need_whole(reading.tables)
        with limited(self._connection, timeout):
            while True:
                answer = self._tried(reading.text, values)
                if answer is not None:
                    return answer
                self._make_samples()
                if self._left_out and not without_damaged:
                    raise InputError(needs_damaged(self._left_out.values()))

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

    def _need_whole(self, names: Collection[str]) -> None:
        """Refuse a query over views from which something damaged is missing."""
        kinds = {kind for name in names for kind in FED_BY.get(name, ())}
        told = [line for k in sorted(kinds) for line in self._catalogue.damaged[k]]
        told += self._left_out.values() if "samples" in names else ()
        if told:
            raise InputError(needs_damaged(told))

    def _drop(self, broken: Mapping[str, str]) -> bool:
        """Read no more of some files; whether there are any."""
        self._left_out |= broken
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
        # Every file of a bucket is asked for, so only where a query is about samples.
        self._make_samples(self._remote is None)

    def _make_samples(self, full: bool = True) -> None:
        self._shown = full
        while True:
            view = samples_view(self._groups() if full else {})
            query = f"CREATE OR REPLACE VIEW samples AS {view}"
            try:
                self._connection.execute(query)
                return
            except duckdb.Error as error:
                if not self._leave_out(error):
                    raise InputError(explain(error)) from error

    def _groups(self) -> dict[Held, list[str]]:
        """Return the files with samples by the signals and joints that they hold."""
        groups: dict = {}
        rows = self._catalogue.rows["runs"].select(["run_id", "signals", "dof"])
        for row in rows.to_pylist():
            folder = self._catalogue.folders["runs"][row["run_id"]]
            file = self._file(folder)
            if file not in self._left_out:
                held = Held(tuple(row["signals"]), row["dof"])
                groups.setdefault(held, []).append(file)
        return groups

    def _file(self, folder: str) -> str:
        """Return what SQL calls the samples of a run."""
        if self._remote:
            folder = f"{self._remote.protocol}://{Path(folder).relative_to(self.path)}"
        return f"{folder}/{SAMPLES_FILE}"

    def _leave_out(self, error: duckdb.Error) -> bool:
        """Leave out the damaged files that an error is about; whether there are any."""
        if self._remote:
            broken = self._watched.broken()
            self._watched.forget()
            return self._drop(broken)
        folders = self._catalogue.folders["runs"].values()
        files = {self._file(folder) for folder in folders} - set(self._left_out)
        named = {file for file in files if file in str(error)}
        before = len(self._left_out)
        # A page that makes no sense is told without the name of its file.
        for file in sorted(named or (files if is_of_files(error) else ())):
            # Read, not believed: a query may have an error and a path in its text.
            try:
                read_parquet(Path(file))
            except InputError as told:
                self._left_out[file] = str(told)
        return len(self._left_out) > before
