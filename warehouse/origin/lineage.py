"""What a record was made from, and what was made from it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from residual.errors import InputError
from warehouse.commit import read_record
from warehouse.files import read_parquet
from warehouse.ids import ID_DIGITS, check_id
from warehouse.kinds import KINDS
from warehouse.layout import Found, find
from warehouse.objects.mirror import shown
from warehouse.query.store import Store

RERUN_OF = "rerun of"


@dataclass(frozen=True, slots=True)
class Relative:
    """A record in a tree of relatives.

    Attributes:
        id: Its id.
        kind: Name of its kind; None where it is not in this store.
        role: What it was to the one above it, or that one to it; "" at the root.
        relatives: Those below it.
        again: Whether it stands elsewhere in the tree, with its relatives.
    """

    id: str
    kind: str | None
    role: str = ""
    relatives: tuple["Relative", ...] = ()
    again: bool = False

    def as_record(self) -> dict:
        """Return it as JSON can hold it."""
        below = [each.as_record() for each in self.relatives]
        told = {"id": self.id, "kind": self.kind, "role": self.role}
        return told | {"again": self.again, "relatives": below}


def tree(store: Store, id: str, down: bool = False) -> Relative:
    """Return what a record was made from, or what was made from it, all the way.

    Raises:
        InputError: If there is no such record.
    """
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


def needed(store: Path, id: str) -> list[Found]:
    """Return a record after all that it was made from: parents stand first.

    Raises:
        InputError: If the record or one that it was made from is not in the store.
    """
    order: dict[str, Found] = {}
    path: set[str] = set()

    def visit(found: Found) -> None:
        if found.id in order or found.id in path:
            return
        path.add(found.id)
        for parent in parents_of(store, found):
            visit(_parent(store, found, parent))
        order[found.id] = found

    visit(find(store, id))
    return list(order.values())


def parents_of(store: Path, found: Found) -> list[str]:
    """Return ids of what a record was made from: its lineage, and what it asked for."""
    rows = read_parquet(found.row, ["lineage"]).column("lineage")[0].as_py() or []
    ids = [row["parent"] for row in rows]
    if found.kind != "runs":
        ids += _ids_in((read_record(store, found.id) or {}).get("request"))
    return list(dict.fromkeys(check_id(id) for id in ids))


def _parent(store: Path, child: Found, id: str) -> Found:
    try:
        return find(store, id)
    except InputError as error:
        raise InputError(
            f"{child.id} ({child.kind}) was made from {id}, which is not in "
            f"{shown(store)}."
        ) from error


def _ids_in(value: object) -> list[str]:
    """Return all whole ids in a request."""
    if isinstance(value, Mapping):
        return [id for item in value.values() for id in _ids_in(item)]
    if isinstance(value, list):
        return [id for item in value for id in _ids_in(item)]
    whole = isinstance(value, str) and len(value) == ID_DIGITS
    return [value] if whole and not set(value) - set("0123456789abcdef") else []


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
    return Relative(id, kind, role, relatives)
