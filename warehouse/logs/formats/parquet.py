"""Parquet logs."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from residual.errors import InputError
from warehouse.logs.file import LogFile

Array = np.ndarray


class ParquetLog(LogFile):
    """A Parquet file."""

    def __init__(self, path: Path) -> None:
        self.name = path.name
        try:
            self._file = pq.ParquetFile(path)
        except (pa.ArrowException, OSError) as error:
            raise InputError(_broken(path.name)) from error
        self._schema = self._file.schema_arrow
        self.columns = tuple(self._schema.names)

    def read(self, columns: tuple[str, ...]) -> dict[str, Array]:
        """Return the values of some columns, NaN where empty."""
        for column in columns:
            kind = self._schema.field(column).type
            if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
                raise InputError(
                    f"{self.name}: column '{column}' holds {kind}, expected numbers."
                )
        try:
            table = self._file.read(columns=list(columns))
        except (pa.ArrowException, OSError) as error:
            raise InputError(_broken(self.name)) from error
        return {c: _floats(table.column(c)) for c in columns}


def _floats(column: pa.ChunkedArray) -> Array:
    return column.cast(pa.float64()).to_numpy().astype(float, copy=False)


def _broken(name: str) -> str:
    return f"{name} is not a readable Parquet file. Export the log again."
