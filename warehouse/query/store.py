"""The store as a database: open it and ask in SQL."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import duckdb
import pyarrow as pa

from residual.errors import InputError
from warehouse.bucket import is_address
from warehouse.catalogue import Catalogue, read_catalogue
from warehouse.files import check_file
from warehouse.quarantine import quarantined
from warehouse.query.guard import (
    Reading,
    check_reads_only,
    collected,
    explain,
    first_line,
    is_of_samples,
    limited,
    lock,
    reads_only,
)
from warehouse.query.views import catalogue_views, signal_rows, view_samples
from warehouse.remote import bucket_of, folder_of, shown
from warehouse.schema import (
    COMPUTED,
    DEFAULT_DOF,
    KINDS,
    TEXT,
    VIEWS,
    arrow_schema,
    sample_columns,
)
from warehouse.sums import SUMS

if TYPE_CHECKING:
    from warehouse.query.samples import Samples

_BATCH = 100_000  # samples that are fetched at once


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


def open_store(path: Path | str, check: bool = True) -> "Store":
    """Open a store for reading.

    Args:
        check: Whether samples are checked as they are read; without it DuckDB's own
            reader takes them, which is faster and sees no flipped bit.
    """
    word = str(path)
    folder = folder_of(word) if is_address(word) else Path(path).resolve()
    if not folder.is_dir():
        raise InputError(
            f"There is no store at {shown(folder)}. Make one with modelgap experiment "
            "or demo, or say where it is: --store FOLDER."
        )
    if set(str(folder)) & set("*?[]{}"):
        raise InputError(f"{path}: the path of a store must not contain * ? [ ] {{ }}.")
    return Store(folder, check)


def ask(path: Path, query: str, **values: object) -> list[dict]:
    """Return the rows of one answer; the store is open for it alone."""
    with open_store(path) as opened:
        return opened.sql(query, values or None).to_pylist()


def runs_where(path: Path, clause: str) -> tuple[str, ...]:
    """Return the ids of the runs that a WHERE clause chooses, in order of recording.

    Args:
        path: The store.
        clause: One condition over the view `runs`, in the SQL of DuckDB. Runs in
            quarantine are left out unless it speaks of them.

    Raises:
        InputError: If it is no condition, or no run fulfils it.
    """
    try:
        # The parser itself says that it is one expression: no bracket ends it early.
        duckdb.SQLExpression(clause)
    except duckdb.Error as error:
        raise InputError(
            f"'{clause}' is not one condition over runs, such as campaign = 'night' "
            f"AND trajectory = 'fourier': {first_line(error)}"
        ) from error
    usable = "true" if "quarantined" in clause.lower() else "NOT quarantined"
    query = f"""SELECT run_id FROM runs WHERE ({clause}
        ) AND {usable} ORDER BY recorded_at, created, run_id"""
    found = tuple(row["run_id"] for row in ask(path, query))
    if not found:
        raise InputError(
            f"No run of {shown(path)} fulfils {clause}. What there is: modelgap sql "
            '"FROM runs".'
        )
    return found


def _unchecked(patterns: Sequence[str], store: Path) -> list[Path]:
    """Return the files of records that a query reads by name, to be checked before.

    Args:
        patterns: Names as DuckDB takes them, with * and ?.
    """
    found = []
    for pattern in patterns:
        within = Path(pattern)
        if within.is_absolute() and within.is_relative_to(store):
            found += store.glob(str(within.relative_to(store)))
    return [path for path in found if (path.parent / SUMS).is_file()]


class Store:
    """An opened store; it sees what others commit meanwhile."""

    def __init__(self, path: Path, check: bool = True) -> None:
        if not check and bucket_of(path):
            raise InputError(f"--no-check reads files, and {shown(path)} has none.")
        self.path, self._check = path, check
        # Of one in a bucket the folder holds copies only.
        self._connection = reads_only(None if bucket_of(path) else path)
        lock(self._connection)
        self._left_out: dict[str, str] = {}
        self._samples: Samples | None = None
        self._quarantined: frozenset[str] = frozenset()
        self._catalogue: Catalogue | None = None  # until somebody asks

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
        if self._check and "samples" in query.lower():
            self._drop(self._make_samples().footers())
        if not without_damaged:
            self._need_whole(reading.tables)
        for path in _unchecked(reading.files, self.path):
            check_file(path)
        with limited(self._connection, timeout):
            while True:
                answer = self._tried(reading, values)
                if answer is not None:
                    return answer
                if not without_damaged:
                    raise InputError(needs_damaged(self._left_out.values()))

    def refresh(self) -> None:
        """See what is committed or quarantined by now."""
        marked, first = quarantined(self.path), self._catalogue is None
        if first or marked != self._quarantined:
            self._quarantined = marked
            ids = pa.array(sorted(marked), TEXT)
            self._table("quarantine", pa.table({"run_id": ids}))
        catalogue = read_catalogue(self.path, self._catalogue)
        if catalogue is not self._catalogue:
            self._catalogue = catalogue
            self._load_catalogue()
        if first:
            self._table("signals", signal_rows())
            for name, query in catalogue_views().items():
                self._connection.execute(f"CREATE VIEW {name} AS {query}")

    def close(self) -> None:
        """Let go of the connection."""
        self._connection.close()

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _tried(self, reading: Reading, values: Mapping | None) -> pa.Table | None:
        """Return an answer; None where something it needs was damaged, now left out."""
        try:
            return self._read(reading.text, values)
        except duckdb.InterruptException:
            raise
        except duckdb.Error as error:
            # Ask again without the files that cannot be read, if that was it.
            if is_of_samples(error) and self._drop(self._samples.broken()):
                return None
            raise InputError(explain(error)) from error

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
        """Read no more of the samples of some runs; whether any of them is new."""
        new = broken.keys() - self._left_out.keys()
        self._left_out |= broken
        if new and self._check:
            self._make_samples()
        return bool(new)

    def _table(self, name: str, rows: pa.Table) -> None:
        self._connection.register("_rows", rows)
        self._connection.execute(
            f"CREATE OR REPLACE TABLE catalogue.{name} AS FROM _rows"
        )
        self._connection.unregister("_rows")

    def _load_catalogue(self) -> None:
        for kind, rows in self._catalogue.rows.items():
            self._table(kind, rows)
        most, runs = self._most_joints(), self._catalogue.folders["runs"]
        if self._check:
            # Until a query is about them: most are not.
            columns = arrow_schema(sample_columns(most))
            self._connection.register("samples", columns.empty_table())
        else:
            view_samples(self._connection, self.path, runs, most)

    def _most_joints(self) -> int:
        known = self._catalogue.rows["runs"].column("dof").to_pylist()
        return max([DEFAULT_DOF, *known])

    def _make_samples(self) -> "Samples":
        # Late, as Arrow's datasets are a slow import.
        from warehouse.query.samples import Samples

        self._samples = self._samples or Samples(self.path)
        found = self._catalogue.folders["runs"]
        known = self._catalogue.rows["runs"].column("run_id").to_pylist()
        folders = {id: found[id] for id in known if id not in self._left_out}
        whole = self._samples.dataset(folders, self._most_joints())
        self._connection.register("samples", whole)
        return self._samples
