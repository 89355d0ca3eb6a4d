"""The store: reads measured logs, keeps runs, models and verdicts, answers SQL.

import warehouse

with warehouse.open("store") as store:
    table = store.sql("SELECT robot, count(*) FROM runs GROUP BY robot")
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from warehouse.queries import Store

__all__ = ["open"]


def open(path: Path | str) -> Store:
    """Open a store for reading (``warehouse.queries.open_store``)."""
    # Late import: reading logs does not need the database.
    from warehouse.queries import open_store

    return open_store(path)
