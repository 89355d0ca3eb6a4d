"""Old runs out of a store, to a folder that keeps them; never one that is referred to.

A run is needed while a model, a diagnosis, a validation or an adoption was made from
it, or an alarm was raised on it. That it was only looked at (watched without an alarm,
or listed in a batch) binds nothing.
"""

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from residual.errors import InputError
from warehouse.files import staged
from warehouse.kinds import SEALED
from warehouse.layout import find_run
from warehouse.objects.mirror import bucket_of, shown
from warehouse.query.store import open_store

LOOKED_AT = ("batch", "watched")
_QUERY = """
    SELECT run_id FROM runs
    WHERE coalesce(recorded_at, created) < $before
      AND ($robot IS NULL OR robot = $robot)
      AND NOT list_has_any(coalesce(tags, []), $keep)
      AND run_id NOT IN
          (SELECT parent FROM lineage WHERE NOT list_contains($looked_at, role))
      AND run_id NOT IN (SELECT run_id FROM alarms WHERE run_id IS NOT NULL)
    ORDER BY coalesce(recorded_at, created), run_id
"""


@dataclass(frozen=True, slots=True)
class Old:
    """A run that nothing refers to.

    Attributes:
        id: Its id.
        folder: Its folder.
        size: Bytes of its files.
    """

    id: str
    folder: Path
    size: int


def old_runs(
    store: Path, days: float, robot: str | None = None, keep: Sequence[str] = ()
) -> list[Old]:
    """Return runs that may leave a store; nothing is changed.

    Args:
        days: How old they are at least, by their recording, else by their commit [d].
        robot: Name of the robot, None for all.
    """
    before = datetime.now(UTC).replace(tzinfo=None) - timedelta(days=days)
    asked = {"before": before, "robot": robot, "keep": list(keep)}
    with open_store(store) as opened:
        found = opened.sql(_QUERY, asked | {"looked_at": list(LOOKED_AT)})
    folders = [find_run(store, id) for id in found.column(0).to_pylist()]
    return [Old(run.id, run.folder, _size(run.folder)) for run in folders]


def move_away(store: Path, old: Old, to: Path) -> Path:
    """Move a run into another folder, at the place that it had in the store.

    Copied first, and out of the store at once: a kill leaves it in the store or in
    both, whole. Its sealed half goes with it.

    Raises:
        InputError: If the folder is in the store, or the store in a bucket.
    """
    to = to.resolve()
    if bucket_of(store):
        raise InputError(
            f"{shown(store)} is in a bucket, of which nothing is moved. Copy what "
            "is to stay with modelgap bundle."
        )
    if to == store or store in to.parents:
        raise InputError(f"{to} is in the store {store}. Give a folder outside of it.")
    seal = store / SEALED / f"run_id={old.id}"
    parts = [old.folder, *([seal] if seal.is_dir() else [])]
    for part in parts:
        target = to / part.relative_to(store)
        draft = target.with_name(f".{target.name}.part")
        shutil.rmtree(draft, ignore_errors=True)
        shutil.copytree(part, draft)
        shutil.rmtree(target, ignore_errors=True)
        os.replace(draft, target)
    for part in parts:
        with staged(store, "moved") as folder:
            os.replace(part, folder / part.name)
    return to / old.folder.relative_to(store)


def _size(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
