"""What a record was made from, what was made from it, and runs that nothing needs.

A run is needed while a model, a diagnosis, a validation or an adoption was made from
it, or an alarm was raised on it. That it was only looked at (watched without an alarm,
or listed in a batch) binds nothing; an old one may go to a folder that keeps it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from warehouse.files import read_sums
from warehouse.ids import seal_folder
from warehouse.layout import find, find_run
from warehouse.query.store import Store, open_store
from warehouse.remote import is_there
from warehouse.schema import KINDS

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
class Relative:
    """A record in a tree of relatives."""

    id: str
    kind: str | None  # name of its kind; None where it is not in this store
    role: str = ""  # what it was to the one above it, or that one to it; "" at the root
    again: bool = False  # whether it stands elsewhere in the tree, with its relatives
    relatives: tuple["Relative", ...] = ()  # those below it


def tree(store: Store, id: str, down: bool = False) -> Relative:
    """Return what a record was made from, or what was made from it, all the way."""
    near, far = ("parent", "child") if down else ("child", "parent")
    links: dict[str, list[tuple[str, str]]] = {}
    rows = store.sql(f"SELECT {near}, {far}, role FROM lineage ORDER BY role, {far}")
    for one, other, role in zip(*rows.to_pydict().values(), strict=True):
        links.setdefault(one, []).append((other, role))
    ids = (f"SELECT {kind.key}, '{name}' FROM {name}" for name, kind in KINDS.items())
    kinds = store.sql(" UNION ALL ".join(ids)).to_pydict()
    kind_of = dict(zip(*kinds.values(), strict=True))
    shown: set[str] = set()

    def grown(id: str, role: str) -> Relative:
        kind, below = kind_of.get(id), links.get(id, [])
        if id in shown:
            return Relative(id, kind, role, again=bool(below))
        shown.add(id)
        relatives = tuple(grown(other, role) for other, role in below)
        return Relative(id, kind, role, relatives=relatives)

    return grown(find(store.path, id).id, "")


@dataclass(frozen=True, slots=True)
class Old:
    """A run that nothing refers to."""

    id: str
    size: int  # bytes of its files
    places: tuple[str, ...]  # its folder in the store, and that of its sealed half


def old_runs(
    store: Path, days: float, robot: str | None = None, keep: Sequence[str] = ()
) -> list[Old]:
    """Return runs that may leave a store; nothing is changed.

    Args:
        days: How old they are at least, by their recording, else by their commit [d].
    """
    before = datetime.now(UTC).replace(tzinfo=None) - timedelta(days=days)
    asked = {"before": before, "robot": robot, "keep": list(keep)}
    with open_store(store) as opened:
        found = opened.sql(_QUERY, asked | {"looked_at": list(LOOKED_AT)})
    old = []
    for id in found.column(0).to_pylist():
        seal = seal_folder(store, id)
        parts = [find_run(store, id).folder, *([seal] if is_there(seal) else [])]
        size = sum(s["bytes"] for part in parts for s in read_sums(part).values())
        places = tuple(part.relative_to(store).as_posix() for part in parts)
        old.append(Old(id, size, places))
    return old
