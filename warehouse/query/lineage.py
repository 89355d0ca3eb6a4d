"""What a record was made from, and what was made from it."""

from dataclasses import dataclass

from warehouse.layout import find
from warehouse.query.store import Store
from warehouse.schema import KINDS


@dataclass(frozen=True, slots=True)
class Relative:
    """A record in a tree of relatives."""

    id: str
    kind: str | None  # name of its kind; None where it is not in this store
    role: str = ""  # what it was to the one above it, or that one to it; "" at the root
    again: bool = False  # whether it stands elsewhere in the tree, with its relatives
    relatives: tuple["Relative", ...] = ()  # those below it


def lineage_tree(store: Store, id: str, down: bool = False) -> Relative:
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
