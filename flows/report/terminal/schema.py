"""What can be asked of a store: its views, and the queries that have a name."""

from collections.abc import Mapping

import pyarrow as pa

from warehouse.query.named import NAMED, TAKES
from warehouse.schema import all_views


def schema_table() -> pa.Table:
    """Return every view and column with type, unit and meaning."""
    rows = [
        {
            "view": view,
            "column": column.name,
            "type": str(column.type),
            "unit": column.unit or "none",
            "about": column.about,
        }
        for view, columns in all_views().items()
        for column in columns
    ]
    return pa.Table.from_pylist(rows)


def named_table() -> pa.Table:
    """Return the named queries with a sentence each, and what they need."""
    rows = [
        {
            "--named": name,
            "answers": about,
            "--with": ", ".join(f"{k}=... ({v})" for k, v in values_of(name).items()),
        }
        for name, (about, _) in NAMED.items()
    ]
    return pa.Table.from_pylist(rows)


def values_of(name: str) -> Mapping[str, str]:
    """Return what a named query takes: what each value is, by its name."""
    return TAKES.get(name, {})
