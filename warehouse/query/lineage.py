"""What a record was made from, what was made from it, and runs that nothing needs.

A run is needed while a model, a diagnosis, a validation or an adoption was made from
it, or an alarm was raised on it. That it was only looked at (watched without an alarm,
or listed in a batch) binds nothing; an old one may go to a folder that keeps it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from warehouse.files import read_sums
from warehouse.ids import check_id, seal_folder
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
    found = find(store.path, id)
    near, far = ("parent", "child") if down else ("child", "parent")
    links: dict[str, list[tuple[str, str]]] = {}
    todo = {found.id}
    while todo:
        listed = ", ".join(f"'{check_id(each)}'" for each in sorted(todo))
        query = f"SELECT child, parent, role FROM lineage WHERE {near} IN ({listed})"
        rows = store.sql(f"{query} ORDER BY role, {far}").to_pylist()
        links |= {each: [] for each in todo}
        for row in rows:
            links[row[near]].append((row[far], row["role"]))
        todo = {row[far] for row in rows} - set(links)
    kinds = _kinds(store, set(links))
    return _grown(found.id, "", links, kinds, set())


def _kinds(store: Store, ids: set[str]) -> dict[str, str]:
    listed = ", ".join(f"'{id}'" for id in sorted(ids))
    parts = (
        f"SELECT {kind.key} AS id, '{name}' AS kind FROM {name} "
        f"WHERE {kind.key} IN ({listed})"
        for name, kind in KINDS.items()
    )
    rows = store.sql(" UNION ALL ".join(parts)).to_pylist()
    return {row["id"]: row["kind"] for row in rows}


def _grown(
    id: str, role: str, links: Mapping, kinds: Mapping, shown: set[str]
) -> Relative:
    kind, below = kinds.get(id), links.get(id, [])
    if id in shown:
        return Relative(id, kind, role, again=bool(below))
    shown.add(id)
    relatives = tuple(_grown(far, r, links, kinds, shown) for far, r in below)
    return Relative(id, kind, role, relatives=relatives)


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
    return [_old(store, id) for id in found.column(0).to_pylist()]


def _old(store: Path, id: str) -> Old:
    seal = seal_folder(store, id)
    parts = [find_run(store, id).folder, *([seal] if is_there(seal) else [])]
    size = sum(each["bytes"] for part in parts for each in read_sums(part).values())
    return Old(id, size, tuple(part.relative_to(store).as_posix() for part in parts))
