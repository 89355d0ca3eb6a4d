"""The store as a database: open it, query it in SQL, follow the lineage of a record."""

import json
import os
from collections.abc import Collection, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import duckdb
import pyarrow as pa

from residual.errors import InputError
from warehouse.bucket import is_bucket_address
from warehouse.record_ids import build_damage_error
from warehouse.remote_store import (
    check_store_folder,
    fetch_file,
    find_local_copy,
    find_store_bucket,
    format_store_name,
)
from warehouse.sql_guard import (
    build_catalogue_views,
    build_signal_table,
    check_reads_only,
    collect_answer,
    explain_error,
    format_duckdb_error,
    limit_query_time,
    open_read_only_connection,
)
from warehouse.store_catalogue import StoreCatalogue, find_record, list_marked_runs, read_catalogue
from warehouse.store_files import replace_file, verify_file
from warehouse.view_schema import (
    COMPUTED,
    DEFAULT_DOF,
    INDEX,
    KINDS,
    OPENED,
    QUARANTINE,
    SAMPLES_FILE,
    TEXT,
    VIEWS,
    build_arrow_schema,
    list_sample_columns,
)

# Errors of a damaged file: also of Arrow between two batches, and of DuckDB whose message
# quotes invalid text.
_FAILURES = (duckdb.Error, pa.ArrowException, OSError, UnicodeDecodeError)
_BATCH = 100_000  # samples that are fetched at once
_AT_ONCE = 2  # files that are hashed or fetched
_HASHED = "hashed.json"
_SPARE = 32  # files that are hashed again rather than listed
_OPENED = """
    SELECT DISTINCT path FROM duckdb_logs_parsed('FileSystem') WHERE op = 'OPEN'
"""


def _feeding(view: str) -> tuple[str, ...]:
    """Return the kinds of record behind a view."""
    if view in ("samples", "channels"):
        return ("runs",)
    if view == "verdicts":
        return ("diagnoses", "runs")
    if view == "adopted":
        return ("adoptions",)
    kinds = [k.name for k in KINDS.values() if view in (k.name, *k.nested_views)]
    # Serial number and time of recording come from runs.
    return tuple(dict.fromkeys([*kinds, *(["runs"] if view in COMPUTED else [])]))


# Kinds of record behind each view.
FED_BY = {view: _feeding(view) for view in (*VIEWS, "samples", "channels")}


def open_store(path: Path | str) -> "Store":
    """Open a store for reading."""
    word = str(path)
    folder = find_local_copy(word) if is_bucket_address(word) else Path(path).resolve()
    check_store_folder(folder)
    if set(str(folder)) & set("*?[]{}"):
        raise InputError(f"{path}: the path of a store must not contain * ? [ ] {{ }}.")
    return Store(folder)


def query_store_rows(path: Path, query: str, **values: object) -> list[dict]:
    """Return the rows of one answer; the store is open for it alone."""
    with open_store(path) as opened:
        return opened.sql(query, values or None).to_pylist()


def select_run_ids(path: Path, clause: str) -> tuple[str, ...]:
    """Return the ids of the runs that a SQL condition over `runs` chooses, by time of recording.

    Runs in quarantine are left out unless the condition speaks of them.

    Raises:
        InputError: If it is no condition, or no run fulfils it.
    """
    try:
        # The parser itself checks that it is one expression: no bracket ends it early.
        duckdb.SQLExpression(clause)
    except duckdb.Error as error:
        raise InputError(
            f"'{clause}' is not one condition over runs, such as campaign = 'night' "
            f"AND trajectory = 'fourier': {format_duckdb_error(error)}"
        ) from error
    usable = "true" if "quarantined" in clause.lower() else "NOT quarantined"
    query = f"""SELECT run_id FROM runs WHERE ({clause}
        ) AND {usable} ORDER BY recorded_at, created, run_id"""
    ids = tuple(row["run_id"] for row in query_store_rows(path, query))
    if not ids:
        raise InputError(
            f"No run in {format_store_name(path)} fulfills {clause}. List the runs: "
            'modelgap sql "FROM runs".'
        )
    return ids


class Store:
    """An open store. Every query sees what was committed before it.

    Catalogue rows are in memory; DuckDB reads the files of samples, and logs which of
    them it opens. After a query over samples these are hashed and compared with the
    sums of their records, so that no answer comes from a damaged file.
    ``_index/hashed.json`` lists the intact files: one is hashed again only if its
    inode, size or modification time has changed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._connection = open_read_only_connection(path)
        self._left_out: dict[str, str] = {}  # messages about damaged samples, by file
        self._hashed: dict[str, list[int]] = {}
        with suppress(OSError, ValueError):
            content = json.loads((path / INDEX / _HASHED).read_bytes())
            self._hashed = content if isinstance(content, dict) else {}
        self._newly_hashed = 0
        self._viewed = False  # whether the view samples is complete
        self._marked: dict[str, frozenset[str]] = {}  # ids of runs, by mark
        self._catalogue: StoreCatalogue | None = None  # until the first query

    @property
    def damaged(self) -> tuple[str, ...]:
        """One line for each file that cannot be read and is left out."""
        if self._catalogue is None:
            self.refresh()
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
            values: Values of the $words in it, as bound parameters.
            without_damaged: Answer from intact records; ``damaged`` lists those left
                out.
            timeout: Time limit [s]; None for no limit.

        Raises:
            InputError: If the query is refused or fails, takes too long, or needs
                damaged records; with the reason.
        """
        names = check_reads_only(self._connection, query)
        self.refresh()
        samples = "samples" in query.lower()
        with limit_query_time(self._connection, timeout):
            while True:
                if samples:
                    self._view_samples()
                    self._connection.execute("CALL truncate_duckdb_logs()")
                if not without_damaged:
                    self._need_whole(names)
                answer = error = None
                try:
                    answer = self._read(query, values)
                except duckdb.InterruptException:
                    raise
                except _FAILURES as failure:
                    error = failure
                broken = self._find_broken_samples(error) if samples else {}
                if not broken and error:
                    raise InputError(explain_error(error)) from error
                if not broken:
                    return answer
                self._leave_out(broken)  # and ask again

    def refresh(self) -> None:
        """Update to the records committed or quarantined since."""
        first = self._catalogue is None
        for mark in (QUARANTINE, OPENED):
            marked = list_marked_runs(self.path, mark)
            if marked != self._marked.get(mark):
                self._marked[mark] = marked
                ids = pa.array(sorted(marked), TEXT)
                self._table(mark, pa.table({"run_id": ids}))
        catalogue = read_catalogue(self.path, self._catalogue)
        if catalogue is not self._catalogue:
            self._catalogue, self._viewed = catalogue, False
            for kind, rows in catalogue.rows.items():
                self._table(kind, rows)
            dofs = catalogue.rows["runs"].column("dof").to_pylist()
            columns = build_arrow_schema(list_sample_columns(max([DEFAULT_DOF, *dofs])))
            self._table("no_samples", columns.empty_table())
            self._view("samples", "FROM catalogue.no_samples")
        if first:
            self._table("signals", build_signal_table())
            for name, query in build_catalogue_views().items():
                self._view(name, query)

    def show_table(self, name: str, rows: pa.Table) -> None:
        """Make rows a view of this connection, beside those of every store."""
        self._table(name, rows)
        self._view(name, f"FROM catalogue.{name}")

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()
        if self._newly_hashed > _SPARE:
            # The next process hashes the files of a read-only store again.
            with suppress(OSError, InputError):
                content = json.dumps(self._hashed).encode()
                replace_file(self.path, self.path / INDEX / _HASHED, content)

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _table(self, name: str, rows: pa.Table) -> None:
        self._connection.register("_rows", rows)
        self._connection.execute(f"CREATE OR REPLACE TABLE catalogue.{name} AS FROM _rows")
        self._connection.unregister("_rows")

    def _view(self, name: str, query: str) -> None:
        self._connection.execute(f"CREATE OR REPLACE VIEW {name} AS {query}")

    def _read(self, query: str, values: Mapping | None) -> pa.Table:
        # A second guard: a statement that passes the first cannot write tables either.
        self._connection.execute("BEGIN TRANSACTION READ ONLY")
        try:
            rows = self._connection.sql(query, params=dict(values) if values else None)
            return collect_answer(rows.to_arrow_reader(_BATCH))
        finally:
            with suppress(duckdb.Error):
                self._connection.execute("ROLLBACK")

    def _need_whole(self, names: Collection[str]) -> None:
        """Refuse a query over views with damaged records."""
        kinds = {kind for name in names for kind in FED_BY.get(name, ())}
        lines = [line for k in sorted(kinds) for line in self._catalogue.damaged[k]]
        lines += self._left_out.values() if "samples" in names else ()
        if lines:
            more = f" And {len(lines) - 3} more." if len(lines) > 3 else ""
            raise InputError(
                f"The answer needs damaged files. {' '.join(lines[:3])}{more} Answer "
                "without them: --without-damaged."
            )

    def _find_broken_samples(self, error: Exception | None) -> dict[str, str]:
        """Return the faults of the files that the last query read, by path."""
        files = set(self._files())
        opened = [path for (path,) in self._connection.sql(_OPENED).fetchall()]
        gone = [f for f in files if error and not os.path.exists(f)]
        broken = self._faults([*opened, *gone])
        if other := broken.keys() - files:
            raise InputError(broken[min(other)])
        return broken

    def _files(self) -> list[str]:
        """Return the files of the view samples."""
        folders = self._catalogue.folders["runs"]
        ids = self._catalogue.rows["runs"].column("run_id").to_pylist()
        paths = (f"{folders[id]}/{SAMPLES_FILE}" for id in ids)
        return [path for path in paths if path not in self._left_out]

    def _view_samples(self) -> None:
        """Create the view of all samples where it is out of date.

        Runs with the same channels are read together: DuckDB opens the first of their
        files to learn the columns, then those that a query needs. For a store in a
        bucket all missing samples are fetched.
        """
        while not self._viewed:
            if find_store_bucket(self.path):
                self._leave_out(self._faults(self._files()))
            rows = self._catalogue.rows["runs"].select(["dof", "signals", "run_id"])
            folders = self._catalogue.folders["runs"]
            forms: dict[tuple, list[str]] = {}
            for dof, signals, id in zip(*rows.to_pydict().values(), strict=True):
                path = f"{folders[id]}/{SAMPLES_FILE}"
                if path not in self._left_out:
                    forms.setdefault((dof, *signals), []).append(path)
            parts = ["FROM catalogue.no_samples"]
            for number, each in enumerate(forms.values()):
                self._connection.execute(f"SET VARIABLE files_{number} = $1", [each])
                parts.append(
                    f"FROM read_parquet(getvariable('files_{number}'), "
                    "hive_partitioning = true, hive_types_autocast = false)"
                )
            try:
                self._view("samples", " UNION ALL BY NAME ".join(parts))
                self._viewed = True
            except _FAILURES as error:
                gone = [path for path in self._files() if not os.path.exists(path)]
                broken = self._faults([*gone, *(each[0] for each in forms.values())])
                if not broken:
                    raise InputError(explain_error(error)) from error
                self._leave_out(broken)

    def _faults(self, paths: Iterable[str]) -> dict[str, str]:
        """Return the faults of files of records, by path; a bucket's are fetched.

        Those without sums beside them, as in ``_index``, are copies of records.
        """

        def fault(path: str) -> str | None:
            try:
                fetch_file(Path(path))
                state = os.stat(path)
                key = [state.st_ino, state.st_size, state.st_ctime_ns]
                if self._hashed.get(path) != key:
                    verify_file(Path(path))
                    self._hashed[path] = key
                    self._newly_hashed += 1
            except InputError as error:
                return str(error)
            except OSError as error:
                return str(build_damage_error(Path(path), error.strerror))
            return None

        index = f"{self.path}/{INDEX}/"
        of_records = {path for path in paths if not path.startswith(index)}
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            messages = zip(of_records, pool.map(fault, of_records), strict=True)
            return {path: text for path, text in messages if text}

    def _leave_out(self, broken: Mapping[str, str]) -> None:
        """Exclude these files from queries."""
        self._left_out |= broken
        if broken:
            self._viewed = False


@dataclass(frozen=True, slots=True)
class LineageNode:
    """A record in a tree of relatives."""

    id: str
    kind: str | None  # name of its kind; None where it is not in this store
    role: str = ""  # its role for the record above it, or the reverse; "" at the root
    again: bool = False  # whether its relatives are listed elsewhere in the tree
    relatives: tuple["LineageNode", ...] = ()  # those below it


def build_lineage_tree(store: Store, id: str, down: bool = False) -> LineageNode:
    """Return all ancestors or all descendants of a record."""
    near, far = ("parent", "child") if down else ("child", "parent")
    links: dict[str, list[tuple[str, str]]] = {}
    rows = store.sql(f"SELECT {near}, {far}, role FROM lineage ORDER BY role, {far}")
    for relative, other, role in zip(*rows.to_pydict().values(), strict=True):
        links.setdefault(relative, []).append((other, role))
    ids = (f"SELECT {kind.key}, '{name}' FROM {name}" for name, kind in KINDS.items())
    kinds = store.sql(" UNION ALL ".join(ids)).to_pydict()
    kind_of = dict(zip(*kinds.values(), strict=True))
    shown: set[str] = set()

    def grown(id: str, role: str) -> LineageNode:
        kind, below = kind_of.get(id), links.get(id, [])
        if id in shown:
            return LineageNode(id, kind, role, again=bool(below))
        shown.add(id)
        relatives = tuple(grown(other, role) for other, role in below)
        return LineageNode(id, kind, role, relatives=relatives)

    return grown(find_record(store.path, id).id, "")
