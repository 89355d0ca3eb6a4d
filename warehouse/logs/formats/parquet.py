"""Parquet logs."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from residual.errors import InputError
from warehouse.logs.file import LogFile
from warehouse.logs.moment import FIELD, from_lines

Array = np.ndarray
BATCH = 1 << 16  # rows


class ParquetLog(LogFile):
    """A Parquet file."""

    def __init__(self, path: Path) -> None:
        self.name = path.name
        try:
            # Read ahead, the file itself would stand in memory too.
            self._file = pq.ParquetFile(path, pre_buffer=False)
        except (pa.ArrowException, OSError) as error:
            raise InputError(_broken(path.name)) from error
        self._schema = self._file.schema_arrow
        self.columns = tuple(self._schema.names)
        told = (self._schema.metadata or {}).get(FIELD.encode(), b"")
        self.recorded_at, _ = from_lines([told.decode(errors="replace")])

    def read(self, columns: tuple[str, ...]) -> dict[str, Array]:
        """Return the values of some columns, NaN where empty."""
        for column in columns:
            kind = self._schema.field(column).type
            if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
                raise InputError(
                    f"{self.name}: column '{column}' holds {kind}, expected numbers."
                )
        values = {c: np.empty(self._file.metadata.num_rows) for c in columns}
        done = 0
        try:
            # Batch by batch: a table of all of it would stand beside the values.
            for batch in self._file.iter_batches(BATCH, columns=list(columns)):
                for c in columns:
                    values[c][done : done + len(batch)] = _floats(batch.column(c))
                done += len(batch)
        except (pa.ArrowException, OSError) as error:
            raise InputError(_broken(self.name)) from error
        return {c: x[:done] for c, x in values.items()}


def _floats(column: pa.Array) -> Array:
    return column.cast(pa.float64()).to_numpy(zero_copy_only=False)


def _broken(name: str) -> str:
    return f"{name} is not a readable Parquet file. Export the log again."
