"""Readers of measured logs, and the checks that every log passes."""

from warehouse.logs.columns import (
    ColumnMap,
    MissingColumnsError,
    columns_of,
    load_columns,
)
from warehouse.logs.read import LogSummary, read_any, read_log, read_table
from warehouse.logs.window import Doubt, check_distinct, unique_ids

__all__ = [
    "ColumnMap",
    "Doubt",
    "LogSummary",
    "MissingColumnsError",
    "check_distinct",
    "columns_of",
    "load_columns",
    "read_any",
    "read_log",
    "read_table",
    "unique_ids",
]
