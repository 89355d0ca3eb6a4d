"""Which parts of which files a query has read, and whether they were whole.

DuckDB logs each read with its place. Only these parts are checked, after the query and
before anybody sees its answer: a query over one run of thousands checks that run, one
over a single channel checks that channel. What was whole is not checked again while
the file has the same size, time and inode.
"""

import json
import os
from collections import defaultdict
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import duckdb

from residual.errors import InputError
from warehouse.kinds import SAMPLES_FILE
from warehouse.runs import check_samples
from warehouse.sums import BLOCK, check_blocks, check_file, damaged

_READS = """
    SELECT message FROM duckdb_logs
    WHERE type = 'FileSystem' AND contains(message, '"op":"READ"')
"""
# One core hashes about as fast as two decode; more would take them from other work.
_THREADS = 2


class Watched:
    """The reads of one connection.

    Attributes:
        copies: Sums of files that lie in no record, by their path (`sums.sums_of`).
    """

    def __init__(self, connection: duckdb.DuckDBPyConnection) -> None:
        self.copies: Mapping[str, Mapping] = {}
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
            return damaged(Path(file), error.strerror)
        key = (file, about.st_ino, about.st_size, about.st_mtime_ns)
        new = blocks - self._whole[key]
        if not new:
            return None
        try:
            if file in self.copies:
                check_blocks(Path(file), self.copies[file], new)
            elif not check_file(Path(file), new) and Path(file).name == SAMPLES_FILE:
                # Of a version without sums: its values against their hash.
                check_samples(Path(file).parent)
                new = set(range(about.st_size // BLOCK + 1))
        except InputError as error:
            return str(error)
        self._whole[key] |= new
        return None
