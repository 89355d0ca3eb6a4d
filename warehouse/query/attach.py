"""A database of views over a store, for programs that know DuckDB and not this one.

An export outside of the store: nothing guards it. Its views read the store's Parquet
files by absolute paths when they are asked, so what is committed later is there too;
nothing is checked against its sums, and whoever opens it may read any file.
"""

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import duckdb

from residual.errors import InputError
from warehouse.kinds import KINDS, QUARANTINE, SAMPLES_FILE
from warehouse.objects.mirror import bucket_of
from warehouse.query.catalogue import read_catalogue
from warehouse.query.views import catalogue_views, signal_rows, text
from warehouse.schema import DEFAULT_DOF, all_views, arrow_schema, sample_columns


def attach(store: Path, file: Path) -> tuple[str, ...]:
    """Write a database of the views of a store; one that is there is replaced.

    Raises:
        InputError: If the store is in a bucket, or the file cannot be written.
    """
    if bucket_of(store) is not None:
        raise InputError(
            "--attach needs a store in a folder: views on a bucket need its keys, "
            "which are not written into a file. Use modelgap sql."
        )
    store = store.resolve()
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=file.parent, prefix=".attach-") as folder:
        draft = Path(folder) / "views.duckdb"
        with duckdb.connect(str(draft)) as made:
            _fill(made, store)
        try:
            os.replace(draft, file)
        except OSError as error:
            raise InputError(f"--attach {file}: {error.strerror}.") from error
    return tuple(all_views())


def _fill(made: duckdb.DuckDBPyConnection, store: Path) -> None:
    folders = read_catalogue(store).folders
    made.execute("CREATE SCHEMA catalogue")
    made.register("_signals", signal_rows())
    made.execute("CREATE TABLE catalogue.signals AS FROM _signals")
    made.unregister("_signals")
    marks = text(f"{store}/{QUARANTINE}/run_id=*.json")
    made.execute(
        "CREATE VIEW catalogue.quarantine AS SELECT replace(parse_filename(file, true),"
        f" 'run_id=', '') AS run_id FROM glob({marks})"
    )
    for name, kind in KINDS.items():
        where = _glob(store, folders[name], kind.row)
        view = _typed(made, name, kind.fields, where)
        made.execute(f"CREATE VIEW catalogue.{name} AS {view}")
    for name, query in catalogue_views().items():
        made.execute(f"CREATE VIEW {name} AS {query}")
    most = made.sql("SELECT max(dof) FROM catalogue.runs").fetchall()[0][0]
    columns = arrow_schema(sample_columns(max(most or 0, DEFAULT_DOF)))
    where = _glob(store, folders["runs"], SAMPLES_FILE)
    view = _typed(made, "samples", columns, where)
    made.execute(f"CREATE VIEW samples AS {view}")


def _glob(store: Path, folders: Mapping[str, str], file: str) -> str | None:
    """Return what matches a file of all records of a kind; None where there are none.

    Records of a kind that has none cannot be read by their names: DuckDB refuses a
    pattern that matches nothing.
    """
    for folder in folders.values():
        first, *rest = Path(folder).relative_to(store).parts
        parts = [part.partition("=")[0] + "=*" if "=" in part else "*" for part in rest]
        return "/".join([str(store), first, *parts, file])
    return None


def _typed(made, name: str, fields, where: str | None) -> str:
    """Return a query for some columns, whatever the files at hand have of them."""
    # An empty table says the types, also where every file is of an earlier version.
    made.register("_none", fields.empty_table())
    made.execute(f"CREATE TABLE catalogue.no_{name} AS FROM _none")
    made.unregister("_none")
    names = ", ".join(f'"{field.name}"' for field in fields)
    if where is None:
        return f"SELECT {names} FROM catalogue.no_{name}"
    how = "union_by_name = true, hive_partitioning = true, hive_types_autocast = false"
    return (
        f"SELECT {names} FROM (FROM catalogue.no_{name} UNION ALL BY NAME "
        f"FROM read_parquet({text(where)}, {how}))"
    )
