"""The connection behind a store: what it reaches, and what a query may take."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa

from residual.errors import InputError
from warehouse.kinds import INDEX, KINDS
from warehouse.query.guard import first_line
from warehouse.query.views import text

# Outside of these no query reads anything: not the sealed halves, not the machine.
READABLE = ("samples", "models", "diagnoses", "validations", INDEX)

# Shares of the memory that a query may take, and its answer on top of that.
WORKING, LARGEST = 0.5, 0.25


def reads_only(path: Path, samples: Any = None) -> duckdb.DuckDBPyConnection:
    """Return a connection that reaches nothing but what may be read of a store.

    Args:
        samples: File system with the samples of a store in a bucket; then nothing of
            the folder is reached.

    Returns:
        The connection; `lock` is still to be called.
    """
    connection = duckdb.connect(":memory:")
    connection.execute("CREATE SCHEMA catalogue")
    places = [f"{path}/{folder}" for folder in READABLE]
    if samples:
        connection.register_filesystem(samples)
        places = [f"{samples.protocol}://samples/"]
    allowed = ", ".join(map(text, places))
    for setting in (
        "autoinstall_known_extensions = false",
        "autoload_known_extensions = false",
        # A query must not see the variables of the program that asks it.
        "python_enable_replacements = false",
        # What comes from a cache would not be checked again after it was damaged.
        "enable_external_file_cache = false",
        "temp_directory = ''",
        f"memory_limit = '{int(WORKING * memory())}B'",
        f"allowed_directories = [{allowed}]",
        "enable_external_access = false",
    ):
        connection.execute(f"SET {setting}")
    return connection


def lock(connection: duckdb.DuckDBPyConnection) -> None:
    """Let no query change a setting."""
    connection.execute("SET lock_configuration = true")


def memory() -> int:
    """Return the memory of this machine [bytes]."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def collected(reader: pa.RecordBatchReader) -> pa.Table:
    """Return an answer as a whole if that can be held.

    Raises:
        InputError: If it is too large.
    """
    batches, size, most = [], 0, LARGEST * memory()
    # Closed also where it is too large: what is not read would hold the transaction.
    with reader:
        for batch in reader:
            batches.append(batch)
            size += batch.nbytes
            if size > most:
                raise InputError(
                    f"The answer is larger than {most / 2**30:.2g} GB, a quarter of "
                    "this machine's memory. Ask for less: aggregate, or add LIMIT or "
                    "a WHERE."
                )
    return pa.Table.from_batches(batches, reader.schema)


@contextmanager
def limited(
    connection: duckdb.DuckDBPyConnection, seconds: float | None
) -> Iterator[None]:
    """Interrupt what runs on a connection after some time.

    Args:
        seconds: How long it may take [s]; None for ever.

    Raises:
        InputError: If it took longer.
    """
    if seconds is None:
        yield
        return
    late = threading.Event()

    def stop() -> None:
        late.set()
        connection.interrupt()

    timer = threading.Timer(seconds, stop)
    timer.daemon = True
    timer.start()
    try:
        yield
    except (duckdb.Error, pa.ArrowException, OSError) as error:
        # Between two batches of an answer Arrow says OSError of it.
        if late.is_set():
            raise InputError(
                f"The query was stopped after {seconds:g} s. Ask for less, or give it "
                "more time with --timeout SECONDS."
            ) from error
        raise
    finally:
        timer.cancel()


def explain(error: duckdb.Error) -> str:
    """Return what an error means for who asked, in one line."""
    if isinstance(error, duckdb.PermissionException):
        what = first_line(error).removeprefix("Permission Error: ")
        return f"SQL reads {', '.join(KINDS)} of this store, nothing else. {what}"
    if isinstance(error, duckdb.OutOfMemoryException):
        most = WORKING * memory() / 2**30
        return (
            f"The query needs more than {most:.2g} GB, half of this machine's memory. "
            f"Ask for less: aggregate, or add a WHERE. ({first_line(error)[:100]})"
        )
    # What Python said to DuckDB, which hands on how it came to that.
    text = str(error).rstrip().splitlines()[-1] if "Traceback" in str(error) else ""
    return text or first_line(error)


def is_of_files(error: duckdb.Error) -> bool:
    """Return whether an error may be about a file, though it need not name it."""
    return type(error) in (duckdb.Error, duckdb.IOException)
