"""Readers of measured logs, and the checks that every log passes."""

from warehouse.logs.column_map import (
    ColumnMap,
    MissingColumnsError,
    choose_column_map,
    read_column_map,
)
from warehouse.logs.log_reading import LogSummary, read_log, read_memory_log
from warehouse.logs.log_window import LogDoubt, check_logs_distinct, create_unique_labels

__all__ = [
    "ColumnMap",
    "LogDoubt",
    "LogSummary",
    "MissingColumnsError",
    "check_logs_distinct",
    "choose_column_map",
    "create_unique_labels",
    "read_column_map",
    "read_log",
    "read_memory_log",
]
