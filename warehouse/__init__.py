"""The world remembered: measured logs come in here; runs and models are kept.

import warehouse

with warehouse.open("store") as store:
    table = store.sql("SELECT robot, count(*) FROM runs GROUP BY robot")
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from warehouse.query.store import Store

__all__ = ["open"]


def open(path: Path | str) -> Store:
    """Open a store for reading (``warehouse.query.store.open_store``)."""
    # Late, so that who only reads logs does not wait for the database.
    from warehouse.query.store import open_store

    return open_store(path)
